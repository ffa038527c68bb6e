# SPDX-License-Identifier: Apache-2.0
"""The policy for SROS2 against what the live nodes publish, hear, serve and ask."""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[2]
NODES = ('sim', 'controller', 'recorder', 'view')
UNUSED = {('view', '/sheep'), ('view', '/dog_*/odom')}
"""What a view hears only where there is no sim to tell the truth."""


def allowed(name: str) -> dict[str, list[str]]:
    """What the policy allows a node, by kind, as full names that may hold stars."""
    policy = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').getroot()
    assert policy.get('version') == '0.2.0'
    (profile,) = [p for p in policy.iter('profile') if p.get('node') == name]
    found: dict[str, list[str]] = {}
    for group in profile:
        (kind,) = group.keys()
        assert group.get(kind) == 'ALLOW'
        for entry in group:
            text = (entry.text or '').replace('~', f'/{name}')
            found.setdefault(kind, []).append(text if text[0] == '/' else f'/{text}')
    return found


def live(node: Any, name: str) -> dict[str, set[str]]:
    ask = {
        'publish': node.get_publisher_names_and_types_by_node,
        'subscribe': node.get_subscriber_names_and_types_by_node,
        'reply': node.get_service_names_and_types_by_node,
        'request': node.get_client_names_and_types_by_node,
    }
    return {kind: {topic for topic, _ in get(name, '/')} for kind, get in ask.items()}


def test_policy_is_what_the_nodes_need(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    start('recorder', bag=tmp_path / 'bag', use_sim_time=True)
    start('view', browser=False, use_sim_time=True)
    start('controller', use_sim_time=True, dogs=2)
    start('sim', dogs=2)

    def names() -> list[str]:
        return [name for name, _ in peer.node.get_node_names_and_namespaces()]

    def everything() -> bool:
        if not set(NODES) <= set(names()):
            return False
        graph = {name: live(peer.node, name) for name in NODES}
        # The recorder has come to hear the last topic and to ask the peer, too.
        return '/plan' in graph['recorder']['subscribe'] and all(
            any(fnmatch(entry, pattern) for entry in graph[name].get(kind, ()))
            for name in NODES
            for kind, patterns in allowed(name).items()
            for pattern in patterns
            if kind != 'request' and (name, pattern) not in UNUSED
        )

    peer.spin_until(everything)
    for name in NODES:
        policy = allowed(name)
        for kind, entries in live(peer.node, name).items():
            for entry in entries:
                assert any(fnmatch(entry, p) for p in policy.get(kind, ())), (name, kind, entry)
