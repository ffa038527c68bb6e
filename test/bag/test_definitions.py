# SPDX-License-Identifier: Apache-2.0
"""Texts of message types: against rosbag2's rules, and against ROS 2's own type hashes."""

from __future__ import annotations

import json
import os
from pathlib import Path
import re

from herding_ros.bag.definitions import message_definition, message_text
import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

BAR = '=' * 80


def definition_of(name: str, texts: dict[str, str]) -> str:
    return message_definition(name, texts.__getitem__)


def test_type_without_others_is_its_own_text() -> None:
    assert definition_of('a_msgs/msg/A', {'a_msgs/msg/A': 'int32 x\n'}) == 'int32 x\n'


def test_used_types_follow_as_in_rosbag2s_documentation() -> None:
    texts = {
        'my_msgs/msg/ExampleMsg': (
            '# defines a message that includes a field of a custom message type\n'
            'my_msgs/BasicMsg my_basic_field\n'
        ),
        'my_msgs/BasicMsg': (
            '# defines a message with a primitive type field\nfloat32 my_float\n'
        ),
    }
    assert definition_of('my_msgs/msg/ExampleMsg', texts) == (
        '# defines a message that includes a field of a custom message type\n'
        'my_msgs/BasicMsg my_basic_field\n'
        f'\n{BAR}\n'
        'MSG: my_msgs/BasicMsg\n'
        '# defines a message with a primitive type field\n'
        'float32 my_float\n'
    )


def test_each_used_type_comes_once_however_deep() -> None:
    texts = {
        'a_msgs/msg/A': 'B[] several\nb_msgs/C[3] three\nb_msgs/C[<=4] some\n',
        'a_msgs/B': 'b_msgs/C c\n',
        'b_msgs/C': 'D d\n',
        'b_msgs/D': 'bool[] flags\n',
    }
    text = definition_of('a_msgs/msg/A', texts)
    names = [line[5:] for line in text.splitlines() if line.startswith('MSG: ')]
    assert names == ['a_msgs/B', 'b_msgs/C', 'b_msgs/D']


def test_constants_comments_and_bounded_strings_are_no_types() -> None:
    text = (
        '# Other things: b_msgs/C c\n'
        'uint8 LIMIT=3\n'
        'string NAME="x"\n'
        'string<=8 short\n'
        'wstring wide # b_msgs/C c\n'
        '  float64[<=2] pair\n'
        '\n'
        'string text "Some default"\n'
    )
    assert definition_of('a_msgs/msg/A', {'a_msgs/msg/A': text}) == text


@pytest.mark.parametrize(
    ('name', 'part'),
    [
        ('std_msgs/String/Extra', 'package/msg/Type'),
        ('std_srvs/srv/Empty_Event', 'package/msg/Type'),
        ('../../etc/passwd', 'package/msg/Type'),
        ('no_such_msgs/msg/A', 'no_such_msgs'),
        ('std_msgs/msg/NoSuchType', 'NoSuchType'),
    ],
)
def test_unknown_type_is_named(name: str, part: str) -> None:
    with pytest.raises(ValueError, match=part):
        message_text(name)


def installed_types() -> list[tuple[str, Path]]:
    return [
        (f'{file.parts[-3]}/msg/{file.stem}', file)
        for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
        for file in sorted(Path(prefix).glob('share/*_msgs/msg/*.json'))
    ]


def test_definitions_of_all_installed_types_have_the_hashes_of_ros() -> None:
    # rosbags parses our text and hashes what it understood; ROS 2 installed its own hash.
    types = installed_types()
    assert len(types) > 100
    for name, file in types:
        hashes = {
            entry['type_name']: entry['hash_string']
            for entry in json.loads(file.read_text())['type_hashes']
        }
        definition = message_definition(name)
        if re.search(r'^char\b', definition, re.MULTILINE):
            continue  # rosbags hashes this one primitive type in another way
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(definition, name))
        assert store.hash_rihs01(name) == hashes[name], name
