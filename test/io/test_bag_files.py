"""A bag's files may be anything: what is sound is read, what is not is mentioned or refused."""

from __future__ import annotations

import resource
import shutil
import sqlite3
import struct
import subprocess
import sys

from backports import zstd
from bags import KINDS, ns
from conftest import examples
from hypothesis import given, settings, strategies as st
import lz4.frame
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState

from redundant_planner.io.bag_files import bag_files
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_repair import close_mcap, repair
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.tools.record_bag import main as record_bag

COUNT = 60


def state(i):
    return serialize_message(JointState(name=['a', 'b'], position=[0.1 * i, 0.0]))


def write_bag(path, numbers=range(COUNT), chunk=None, sqlite=False, mode='none'):
    """A bag of numbered joint states; a chunk is closed after every so many."""
    if not sqlite and mode == 'none':
        with BagWriter(path) as bag:
            bag.add_topic('/joint_states', KINDS['joint_states'])
            for i in numbers:
                bag.write('/joint_states', ns(0.01 * i), state(i))
                if chunk and i % chunk == chunk - 1:
                    bag.flush()
        return path
    writer = Writer(path, version=9,
                    storage_plugin=StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP)
    if mode != 'none':
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/joint_states', KINDS['joint_states'],
                                           typestore=get_typestore(Stores.ROS2_JAZZY))
        for i in numbers:
            writer.write(connection, ns(0.01 * i), state(i))
    return path


def numbers_in(path):
    """The numbers of the joint states in a bag, and what it says of itself."""
    with open_bag(path) as bag:
        found = [item.positions[:, 0] * 10.0 for item in bag.read(['joint_states'])
                 if isinstance(item, JointChunk)]
        return np.round(np.concatenate([*found, np.empty(0)])).astype(int).tolist(), bag.problems


def mcap_in(path):
    return next(path.glob('*.mcap'))


@pytest.fixture(scope='module')
def sound(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('sound') / 'bag', chunk=20)


def test_a_folder_without_metadata_and_a_split_bag_are_read(tmp_path):
    parts = [write_bag(tmp_path / f'part{i}', range(20 * i, 20 * i + 20)) for i in range(3)]
    folder = tmp_path / 'bag'
    folder.mkdir()
    for i, part in zip((1, 0, 2), parts):  # names do not tell the order
        shutil.copy(mcap_in(part), folder / f'bag_{i}.mcap')
    assert numbers_in(folder) == (list(range(COUNT)), [])


def test_metadata_that_lies_changes_nothing(tmp_path):
    bag = write_bag(tmp_path / 'bag')
    file = bag / 'metadata.yaml'
    file.write_text(file.read_text().replace(f'message_count: {COUNT}', 'message_count: 0'))
    assert numbers_in(bag) == (list(range(COUNT)), [])
    file.write_text('{')
    assert numbers_in(bag) == (list(range(COUNT)), [])


@settings(deadline=None, max_examples=examples(150))
@given(data=st.data())
def test_whatever_is_done_to_a_file_the_rest_is_read_or_it_is_refused(
        sound, tmp_path_factory, data):
    whole = bytearray(mcap_in(sound).read_bytes())
    at = data.draw(st.integers(0, len(whole) - 1))
    kind = data.draw(st.sampled_from(['flip', 'cut', 'zeros', 'number', 'noise']))
    if kind == 'flip':
        whole[at] ^= 1 << data.draw(st.integers(0, 7))
    elif kind == 'cut':
        del whole[at:]
    elif kind == 'zeros':
        whole[at:at + 200] = bytes(len(whole[at:at + 200]))
    elif kind == 'number':
        number = data.draw(st.sampled_from([0, 1, 2**31, 2**63, 2**64 - 1]))
        whole[at:at + 8] = struct.pack('<Q', number)[:len(whole[at:at + 8])]
    else:
        whole[at:at + 50] = data.draw(st.binary(max_size=50))
    file = tmp_path_factory.mktemp('damaged') / 'bag.mcap'
    file.write_bytes(whole)
    try:
        found, problems = numbers_in(file)
        with open_bag(file) as bag:
            topics = set(bag.topics)
    except RecordingError as error:
        assert str(file) in str(error)
        return
    assert len(found) <= COUNT
    # What is missing is not missing in silence, unless it is the name of the topic.
    assert len(found) == COUNT or problems or topics != {'joint_states'}


def test_a_damaged_chunk_costs_itself_alone(sound, tmp_path):
    """With a checksum even where a number alone is wrong."""
    whole = bytearray(mcap_in(sound).read_bytes())
    chunk = 8 + 9 + struct.unpack_from('<Q', whole, 9)[0]  # behind the header record
    unpacked = struct.unpack_from('<Q', whole, chunk + 9 + 16)[0]
    begin = chunk + 9 + 28 + 4 + 8
    struct.pack_into('<I', whole, chunk + 9 + 24, 12345)  # not its checksum
    file = tmp_path / 'bag.mcap'
    file.write_bytes(whole)
    assert begin + unpacked < len(whole)
    found, problems = numbers_in(file)
    # The first chunk describes the topic, too; the end of the file does so again.
    assert found == list(range(20, COUNT))
    assert problems == [
        "'bag.mcap': a chunk is damaged",
        f"'bag.mcap': it should hold {COUNT} messages, and {COUNT - 20} were found"]


def test_times_that_no_stamp_can_hold_are_left_out(tmp_path):
    path = tmp_path / 'bag'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for i in range(5):
            bag.write('/joint_states', ns(0.01 * i), state(i))
        bag.write('/joint_states', 2**63, state(7))
    found, problems = numbers_in(path)
    assert found == list(range(5))
    assert 'impossible time' in problems[0]


def packed_chunk(compression, packed, unpacked):
    """An MCAP file with one chunk, which says that it unpacks to so many bytes."""
    def record(kind, content):
        return struct.pack('<BQ', kind, len(content)) + content

    def text(content):
        return struct.pack('<I', len(content)) + content

    chunk = struct.pack('<QQQI', 0, 2**62, unpacked, 0) + text(compression) + struct.pack(
        '<Q', len(packed)) + packed
    return (b'\x89MCAP0\r\n' + record(1, text(b'ros2') + text(b'')) + record(6, chunk)
            + record(0x0F, bytes(4)) + record(2, bytes(20)) + b'\x89MCAP0\r\n')


@pytest.mark.first_alone
@pytest.mark.parametrize('claimed', [1000, 600_000_000])
@pytest.mark.parametrize('kind', ['zstd', 'lz4', 'file'])
def test_nothing_unpacks_into_the_whole_memory(tmp_path, kind, claimed):
    """In a process of its own, whose memory is bounded."""
    zeros = bytes(600_000_000)
    packed = lz4.frame.compress(zeros) if kind == 'lz4' else zstd.compress(zeros)
    file = tmp_path / 'bag.mcap'
    file.write_bytes(packed if kind == 'file' else packed_chunk(kind.encode(), packed, claimed))
    limit = 400_000_000

    def bounded():
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))

    done = subprocess.run(
        [sys.executable, '-c', 'import sys; from pathlib import Path\n'
         'from redundant_planner.io.bag_files import bag_files\n'
         'found = bag_files(Path(sys.argv[1]), Path(sys.argv[2]))\n'
         'print(found[0].problems)', str(file), str(tmp_path)],
        preexec_fn=bounded, capture_output=True, text=True, timeout=120, check=False,
        env={'OPENBLAS_NUM_THREADS': '1', 'PYTHONPATH': ':'.join(filter(None, sys.path))})
    assert 'MemoryError' not in done.stderr, done.stderr
    if kind == 'file':
        assert 'is neither MCAP nor sqlite3' in done.stderr
    else:
        assert 'a chunk' in done.stdout, done.stderr


@pytest.mark.first_alone
@pytest.mark.parametrize('mode', ['message', 'file'])
def test_packed_bags_that_are_damaged_are_read_as_far_as_they_go(tmp_path, mode):
    bag = write_bag(tmp_path / 'bag', range(30_000), mode=mode)
    assert numbers_in(bag) == (list(range(30_000)), [])
    file = next(f for f in bag.iterdir() if f.name != 'metadata.yaml')
    whole = file.read_bytes()
    if mode == 'file':
        file.write_bytes(whole[:-len(whole) // 3])
    else:  # the first message is no frame any more
        begin = whole.index(b'\x28\xb5\x2f\xfd')
        first = whole[begin:begin + 8]
        file.write_bytes(whole.replace(first, first[:4] + b'\xff' + first[5:], 1))
    found, problems = numbers_in(bag)
    assert problems and 0 < len(found) < 30_000


def test_a_database_that_was_cut_is_read_as_far_as_it_goes(tmp_path):
    bag = write_bag(tmp_path / 'bag', range(3000), sqlite=True)
    file = next(bag.glob('*.db3'))
    whole = file.read_bytes()
    file.write_bytes(whole[:len(whole) // 3])
    found, problems = numbers_in(bag)
    assert 100 < len(found) < 3000 and found == list(range(len(found)))
    assert len(problems) == 1 and 'damaged' in problems[0]
    file.write_bytes(whole[:50])
    with pytest.raises(RecordingError, match='is not a readable bag'):
        numbers_in(bag)


def test_a_database_may_hold_anything_in_its_columns(tmp_path):
    bag = write_bag(tmp_path / 'bag', sqlite=True)
    database = sqlite3.connect(next(bag.glob('*.db3')))
    for time, data in (('soon', b''), (ns(0.0), 'text'), (-5, b''), (2**62, b''), (ns(0.0), 3)):
        database.execute('INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)',
                         (time, data))
    database.execute("INSERT INTO topics VALUES (7, x'ff00', 3, '', '', '')")
    database.commit()
    database.close()
    found, problems = numbers_in(bag)
    assert found == list(range(COUNT))
    assert '3 messages of an impossible time' in problems[0]


def test_order_of_time_holds_across_chunks(tmp_path):
    """A chunk may begin before the one ahead of it ends."""
    path = tmp_path / 'bag'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for i in (0, 2, 4, 1, 3, 5):
            bag.write('/joint_states', ns(0.01 * i), state(i))
            if i == 4:
                bag.flush()
    assert numbers_in(path) == (list(range(6)), [])


def test_repair_loses_nothing_and_repairs_only_what_it_can(sound, tmp_path, capfd):
    whole = mcap_in(sound).read_bytes()
    file = tmp_path / 'bag.mcap'
    file.write_bytes(whole[:len(whole) // 2])
    assert record_bag(['--repair', str(file)]) == 0
    assert 'is closed now' in capfd.readouterr().out
    rest = tmp_path / 'bag.mcap.rest'
    begin = file.read_bytes()
    assert (begin[:-50] + rest.read_bytes())[:len(whole) // 2] == whole[:len(whole) // 2]
    assert record_bag(['--repair', str(file)]) == 0
    assert 'was closed properly' in capfd.readouterr().out
    damaged = bytearray(whole)
    struct.pack_into('<Q', damaged, 9, 2**40)
    for content, message in ((b'', 'the file is empty'), (b'PK\3\4' * 9, 'not an MCAP bag'),
                             (damaged, 'damaged at byte 8')):
        file.write_bytes(content)
        assert record_bag(['--repair', str(file)]) == 2
        error = capfd.readouterr().err
        assert message in error and len(error.splitlines()) == 1
        assert file.read_bytes() == bytes(content)


def test_an_earlier_rest_is_not_overwritten(sound, tmp_path):
    whole = mcap_in(sound).read_bytes()
    file = tmp_path / 'bag.mcap'
    file.write_bytes(whole[:len(whole) // 2])
    (tmp_path / 'bag.mcap.rest').write_bytes(b'precious')
    with pytest.raises(OSError, match='exists'):
        close_mcap(file)
    assert (tmp_path / 'bag.mcap.rest').read_bytes() == b'precious'
    assert file.read_bytes() == whole[:len(whole) // 2]
    with pytest.raises(RecordingError, match='not an MCAP bag'):
        repair(tmp_path / 'gone')


def test_an_empty_file_and_an_empty_folder_are_refused(tmp_path):
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'bag.mcap').touch()
    with pytest.raises(RecordingError, match=r'no \.mcap and no \.db3'):
        bag_files(tmp_path / 'empty', tmp_path)
    with pytest.raises(RecordingError, match='the file is empty'):
        bag_files(tmp_path / 'bag.mcap', tmp_path)
