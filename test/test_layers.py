# SPDX-License-Identifier: Apache-2.0
import ast
from collections.abc import Iterator
from pathlib import Path
import subprocess
import sys

import herding_ros
import pytest

PACKAGE = Path(herding_ros.__file__).parent
# What each layer may import from the package, besides itself.
MAY_IMPORT = {
    'model': set(),
    'control': {'model'},
    'studies': {'model', 'control', 'report', 'fit'},
    'bag': set(),
    'fit': {'model', 'control', 'bag', 'report'},
    'report': {'bag', 'model'},
    'view': {'model', 'bag', 'report'},
    'nodes': {'model', 'control', 'bag', 'report', 'view'},
}
ROS_ONLY_IN_NODES = {'rclpy', 'launch', 'launch_ros', 'builtin_interfaces', 'std_srvs', 'rpyutils'}


def is_ros(module: str) -> bool:
    top = module.split('.')[0]
    return top in ROS_ONLY_IN_NODES or top.endswith(('_msgs', '_interfaces'))


def imports(path: Path) -> Iterator[str]:
    """Yield the full name of every module a file imports, wherever in the file."""
    package = ['herding_ros', *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = '.'.join([*base, *([node.module] if node.module else [])])
            # `from . import kernels` names modules, `from .state import Array` does not:
            # the longer name is good for both, as only the layer is looked at.
            yield from (f'{stem}.{alias.name}' for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
            ('import_module', '__import__')
        ):
            yield from (arg.value for arg in node.args if isinstance(arg, ast.Constant))


def layers() -> list[str]:
    return sorted(path.parent.name for path in PACKAGE.glob('*/__init__.py'))


def test_every_layer_has_its_rule() -> None:
    assert set(layers()) <= set(MAY_IMPORT)
    assert {'model', 'control', 'nodes', 'bag', 'report'} <= set(layers())


@pytest.mark.parametrize('layer', layers())
def test_imports_go_one_way(layer: str) -> None:
    allowed = MAY_IMPORT[layer] | {layer}
    wrong = [
        f'{path.relative_to(PACKAGE)} imports {module}'
        for path in sorted((PACKAGE / layer).rglob('*.py'))
        for module in imports(path)
        if module.startswith('herding_ros.')
        and (PACKAGE / module.split('.')[1]).is_dir()
        and module.split('.')[1] not in allowed
    ]
    assert wrong == []


def test_ros_appears_in_the_nodes_alone() -> None:
    wrong = [
        f'{path.relative_to(PACKAGE)} imports {module}'
        for path in sorted(PACKAGE.rglob('*.py'))
        if path.relative_to(PACKAGE).parts[0] != 'nodes'
        for module in imports(path)
        if is_ros(module)
    ]
    assert wrong == []


def test_the_nodes_do_use_ros() -> None:
    """Guards the two tests above: they find what they look for."""
    found = {module for path in (PACKAGE / 'nodes').glob('*.py') for module in imports(path)}
    assert any(is_ros(module) for module in found)
    assert any(module.startswith('herding_ros.control') for module in found)
    assert any(module.startswith('herding_ros.model') for module in found)


@pytest.mark.parametrize(
    ('program', 'heavy'), [('recorder', ['numba', 'scipy']), ('herd', ['numba', 'matplotlib'])]
)
def test_programs_load_only_what_they_need_at_the_start(program: str, heavy: list[str]) -> None:
    loaded = f'import sys, herding_ros.nodes.{program}; print(*sys.modules)'
    done = subprocess.run(
        [sys.executable, '-c', loaded], capture_output=True, text=True, check=True
    )
    assert not set(heavy) & set(done.stdout.split())
