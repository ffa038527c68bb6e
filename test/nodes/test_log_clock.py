# SPDX-License-Identifier: Apache-2.0
"""The log times of a recording, without ROS."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from herding_ros.bag.metadata import read_metadata
from herding_ros.bag.writer import BagWriter, NewTopic
from herding_ros.nodes.log_clock import rewritten
from mcap.reader import make_reader
import pytest

TOPIC = NewTopic('/a', 'std_msgs/msg/String', 'string data', [], 'RIHS01_0')
MESSAGES = [b'%05d' % k * 2000 for k in range(12)]


def bag_of_several_files(path: Path) -> BagWriter:
    bag = BagWriter(path, {'key': 'value'}, max_size=15_000)
    bag.add_topic(*TOPIC)
    for k, data in enumerate(MESSAGES):
        bag.write('/a', data, 10**18 + k, 10**18 + k)
    return bag


def messages_in(folder: Path) -> list[tuple[bytes, int, int]]:
    """Data, log time and publish time [ns] of the messages, file by file."""
    found = []
    for name in read_metadata(folder)['relative_file_paths']:
        with (folder / name).open('rb') as stream:
            for _, _, message in make_reader(stream).iter_messages(log_time_order=False):
                found.append((message.data, message.log_time, message.publish_time))
    return found


def test_messages_before_the_clock_get_its_first_time(tmp_path: Path) -> None:
    early = bag_of_several_files(tmp_path / 'bag')
    assert early.file_count > 3
    bag = rewritten(early, partial(BagWriter, tmp_path / 'bag', {'key': 'value'}), 5)
    bag.write('/a', b'later', 7, 10**18 + 99)
    bag.close()
    expected = [(data, 5, 10**18 + k) for k, data in enumerate(MESSAGES)]
    assert messages_in(tmp_path / 'bag') == [*expected, (b'later', 7, 10**18 + 99)]
    assert read_metadata(tmp_path / 'bag')['custom_data'] == {'key': 'value'}
    assert [path.name for path in tmp_path.iterdir()] == ['bag']


def test_disk_that_refuses_the_new_bag_leaves_the_old_one(tmp_path: Path) -> None:
    early = bag_of_several_files(tmp_path / 'bag')

    def refuse() -> BagWriter:
        (tmp_path / 'bag').mkdir()
        raise OSError('the disk is full')

    with pytest.raises(OSError, match='full'):
        rewritten(early, refuse, 5)
    assert [data for data, _, _ in messages_in(tmp_path / 'bag')] == MESSAGES
    assert [path.name for path in tmp_path.iterdir()] == ['bag']
