# SPDX-License-Identifier: Apache-2.0
"""Shared memory as Python sees it: what is read, what is refused, and who may write."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from lithe import _wire, shm
from lithe.shm import BrainWriter, RingCursor, ShmError, SpineView
from segments import Writer, make_file, own_prefix, remove

ROBOT = "arm"
SLOT = 64  # ring records start on multiples of it, the first one 128 bytes into the ring


@pytest.fixture(autouse=True)
def _names(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A prefix of its own for each test."""
    monkeypatch.setenv("LITHE_SHM_PREFIX", own_prefix())
    yield
    remove(ROBOT)


@pytest.fixture
def spine() -> Writer:
    """A spine segment of a robot with two joints."""
    writer = Writer(ROBOT, "spine")
    names = ["shoulder", "elbow"] + [""] * (_wire.NJ - 2)
    writer.channel("robot_info", joint_count=2, rate_hz=1000.0, robot=ROBOT, joint_name=names)
    return writer


@pytest.fixture
def brain() -> Path:
    """An empty brain segment."""
    return make_file(ROBOT, "brain")


def plan() -> np.ndarray:
    """The plan that lies in the brain segment."""
    entry = shm.Mapping(ROBOT, "brain", writable=False).channel("plan")
    assert entry is not None
    return entry[1]


# ---- reading


def test_the_view_tells_who_the_robot_is(spine: Writer) -> None:
    view = SpineView(ROBOT)
    assert view.joint_names == ["shoulder", "elbow"]
    assert view.info["rate_hz"] == 1000.0
    assert view.latest() is None
    assert view.params() is None
    assert view.laws() == []


def test_laws_and_parameters_come_from_their_channels(spine: Writer) -> None:
    spine.channel("law_info", 3, law_id=7, name="pd")
    spine.channel("law_info", 5, law_id=0, name="gone")
    spine.channel("params", law_id=7, count=1, value=np.arange(32.0))
    view = SpineView(ROBOT)
    assert [(law["law_id"].item(), law["name"].item()) for law in view.laws()] == [(7, b"pd")]
    params = view.params()
    assert params is not None
    assert params["value"][31] == 31.0


def test_a_histogram_is_read_whole(spine: Writer) -> None:
    bins = np.arange(_wire.NBIN, dtype=np.uint64)
    spine.scribble("handoff", bins.tobytes())
    assert (SpineView(ROBOT).histogram("handoff") == bins).all()
    assert not SpineView(ROBOT).histogram("tick").any()


def test_a_view_of_a_robot_that_has_not_finished_starting_says_so() -> None:
    Writer(ROBOT, "spine")
    with pytest.raises(ShmError, match="has not finished starting: try again"):
        SpineView(ROBOT)


def test_the_spine_is_alive_while_its_heartbeat_is_young(spine: Writer) -> None:
    view = SpineView(ROBOT)
    assert view.is_alive(within_s=60)
    heart = spine.mapping.base + _wire.SegmentHeader.heartbeat_ns.offset
    shm.shim().lithe_store(heart, 1)
    assert not view.is_alive(within_s=0.01)


def test_drain_gives_each_record_once_in_order_from_now_on(spine: Writer) -> None:
    spine.push("telemetry", tick=1)
    cursor = SpineView(ROBOT).telemetry()
    assert len(cursor.drain()) == 0
    for tick in range(2, 12):
        spine.push("telemetry", tick=tick, position_rad=np.full(32, float(tick)))
    records = cursor.drain()
    assert records["tick"].tolist() == list(range(2, 12))
    assert (records["position_rad"] == records["tick"][:, None]).all()
    assert len(cursor.drain()) == 0
    assert cursor.lost == 0


def test_drain_takes_no_more_than_asked_for_and_goes_on_there(spine: Writer) -> None:
    cursor = SpineView(ROBOT).telemetry()
    for tick in range(1, 8):
        spine.push("telemetry", tick=tick)
    assert [cursor.drain(3)["tick"].tolist() for _ in range(3)] == [[1, 2, 3], [4, 5, 6], [7]]


def test_a_cursor_that_was_lapped_says_how_many_it_lost(spine: Writer) -> None:
    view = SpineView(ROBOT)
    slow = view.events("loader")
    depth = _wire.SEGMENTS["spine"]["events_loader"].depth
    for number in range(depth + 10):
        spine.push("events_loader", tick=number)
    assert slow.drain()["tick"].tolist() == list(range(10, depth + 10))
    assert slow.lost == 10
    late = view.events("loader", from_oldest=True)
    assert len(late.drain()) == depth
    assert late.lost == 0


def test_a_record_that_is_being_written_is_never_handed_out(spine: Writer) -> None:
    cursor = RingCursor(SpineView(ROBOT).mapping, "events_tick")
    for number in range(1, 4):
        spine.push("events_tick", tick=number)
    size = (8 + _wire.SIZES["Event"] + SLOT - 1) // SLOT * SLOT
    spine.scribble("events_tick", (2 * 258 + 1).to_bytes(8, "little"), at=128 + size)  # record 2 gives way to 258
    assert cursor.drain()["tick"].tolist() == [1, 3]
    assert cursor.lost == 1


def test_the_newest_record_is_not_given_while_it_is_odd(spine: Writer) -> None:
    view = SpineView(ROBOT)
    spine.push("telemetry", tick=41)
    newest = view.latest()
    assert newest is not None
    assert newest["tick"] == 41
    spine.scribble("telemetry", (3).to_bytes(8, "little"), at=128)
    assert view.latest() is None


def test_what_was_read_is_a_private_copy(spine: Writer) -> None:
    view = SpineView(ROBOT)
    cursor = view.telemetry()
    spine.push("telemetry", tick=1)
    records, newest = cursor.drain(), view.latest()
    assert newest is not None
    spine.scribble("telemetry", b"\xff" * 4096)
    assert records["tick"].tolist() == [1]
    assert newest["tick"] == 1
    records["tick"] = 5  # and may be changed


def test_garbage_in_the_segment_ends_in_no_record_and_no_crash(spine: Writer) -> None:
    view = SpineView(ROBOT)
    noise = random.Random(1)
    for _ in range(200):
        for name in ("telemetry", "events_tick", "params"):
            spine.scribble(name, noise.randbytes(8192))
        view.latest()
        view.params()
        assert len(view.telemetry(from_oldest=True).drain()) <= _wire.SEGMENTS["spine"]["telemetry"].depth
        assert len(view.events(from_oldest=True).drain(10)) <= 10


# ---- refusing


def test_a_robot_that_does_not_run_is_named() -> None:
    with pytest.raises(ShmError, match=r"robot 'arm' is not running .* is absent\): lithe run ROBOT.toml"):
        SpineView(ROBOT)


def test_a_file_that_is_too_short_is_refused() -> None:
    shm.shm_path(ROBOT, "spine").write_bytes(b"x" * 100)
    with pytest.raises(ShmError, match=r"too short for this build \(100 bytes\): restart the robot"):
        SpineView(ROBOT)


def test_a_file_of_garbage_is_refused() -> None:
    shm.shm_path(ROBOT, "brain").write_bytes(random.Random(2).randbytes(_wire.SEGMENT_BYTES["brain"] + 10))
    with pytest.raises(ShmError, match="not a LITHE segment: remove it and restart the robot"):
        BrainWriter(ROBOT)


def test_another_layout_is_refused_with_the_fields_that_differ() -> None:
    line = next(each for each in _wire.CANONICAL_SCHEMA.splitlines() if each.startswith("Telemetry.torque_nm:"))
    other = _wire.CANONICAL_SCHEMA.replace(line, line.replace("float64[32]", "float64[12]"))
    other = "".join(each for each in other.splitlines(True) if not each.startswith("Plan.streaming:"))
    make_file(ROBOT, "spine", schema=other, layout_hash=1)
    with pytest.raises(ShmError) as caught:
        SpineView(ROBOT)
    text = str(caught.value).splitlines()
    assert text[0].endswith("was made by a build with another layout:")
    assert text[1:-1] == [
        f"  here  {line}",
        f"  there {line.replace('float64[32]', 'float64[12]')}",
        next(f"  here  {each}" for each in _wire.CANONICAL_SCHEMA.splitlines() if each.startswith("Plan.streaming:")),
        "  there (absent)",
    ]
    assert text[-1] == "build both from one schema"


def test_a_layout_that_only_grew_at_its_end_is_accepted() -> None:
    make_file(ROBOT, "brain", schema=_wire.CANONICAL_SCHEMA + "Extra.more:uint64[1]:0:8:-\n", layout_hash=1)
    BrainWriter(ROBOT).close()


def test_a_header_whose_schema_text_lies_elsewhere_is_refused() -> None:
    make_file(ROBOT, "brain", layout_hash=1, schema_offset=2**63)
    with pytest.raises(ShmError, match="schema text lies outside the segment: remove it and restart the robot"):
        BrainWriter(ROBOT)


# ---- writing


def test_a_plan_arrives_as_it_was_published(brain: Path) -> None:
    writer = BrainWriter(ROBOT)
    positions = np.arange(6.0).reshape(3, 2)
    writer.publish(9, [10, 20, 30], positions, velocity_rad_s=-positions, streaming=False)
    arrived = plan()
    assert [int(arrived[name]) for name in ("plan_id", "waypoint_count", "joint_count", "streaming")] == [9, 3, 2, 0]
    assert arrived["t_ns"][:3].tolist() == [10, 20, 30]
    for field, expected in (("position_rad", positions), ("velocity_rad_s", -positions)):
        by_waypoint = arrived[field].reshape(_wire.NW, _wire.NJ)
        assert (by_waypoint[:3, :2] == expected).all()
    writer.close()


def test_velocities_left_out_are_the_spines_to_choose(brain: Path) -> None:
    writer = BrainWriter(ROBOT)
    writer.publish(1, [1, 2], [[0.0], [1.0]], velocity_rad_s=[[3.0], [3.0]])
    writer.publish(2, [1, 2], [[0.0], [1.0]])
    assert np.isnan(plan()["velocity_rad_s"]).all(), "those of the plan before are gone"
    writer.close()


@pytest.mark.parametrize(
    ("t_ns", "position_rad", "velocity_rad_s"),
    [
        ([1, 2], [0.0, 1.0], None),
        ([1], [[0.0], [1.0]], None),
        ([], np.zeros((0, 1)), None),
        (list(range(17)), np.zeros((17, 1)), None),
        ([1], np.zeros((1, 33)), None),
        ([1, 2], [[0.0], [1.0]], [[0.0, 0.0], [1.0, 1.0]]),
        ([1, 2], [[0.0], [1.0]], 3.0),
    ],
)
def test_a_plan_of_the_wrong_shape_is_refused_and_the_old_one_stays(
    brain: Path, t_ns: list[int], position_rad: object, velocity_rad_s: object
) -> None:
    writer = BrainWriter(ROBOT)
    writer.publish(1, [1, 2], [[0.0], [1.0]])
    with pytest.raises(ShmError, match="a plan"):
        writer.publish(2, t_ns, position_rad, velocity_rad_s)  # type: ignore[arg-type]
    assert plan()["plan_id"] == 1
    writer.publish(3, [1, 2], [[0.0], [1.0]])
    assert int(plan()["waypoint_count"]) == 2
    writer.close()


def test_a_writer_signs_in_and_every_plan_is_a_sign_of_life(brain: Path) -> None:
    first = BrainWriter(ROBOT)
    first.close()
    writer = BrainWriter(ROBOT)
    before = writer.mapping.header()
    assert (before.writer_pid, before.epoch) == (os.getpid(), 2)
    writer.publish(1, [1], [[0.0]])
    assert writer.mapping.header().heartbeat_ns > before.heartbeat_ns
    writer.close()


def test_the_estop_word_stays_until_it_is_released(brain: Path) -> None:
    writer = BrainWriter(ROBOT)
    writer.press_estop()
    writer.close()
    seen = shm.Mapping(ROBOT, "brain", writable=False)
    assert seen.load("estop") == 1
    writer = BrainWriter(ROBOT)
    writer.press_estop(False)
    writer.close()
    assert seen.load("estop") == 0


def test_a_second_brain_is_refused_and_told_who_the_first_is(brain: Path) -> None:
    writer = BrainWriter(ROBOT)
    with pytest.raises(ShmError, match=rf"robot 'arm' already has a Brain \(pid {os.getpid()}\): stop it first"):
        BrainWriter(ROBOT)
    writer.close()
    BrainWriter(ROBOT).close()


def test_the_lock_file_is_for_the_group_whatever_the_umask(brain: Path) -> None:
    before = os.umask(0o077)
    try:
        BrainWriter(ROBOT).close()
    finally:
        os.umask(before)
    assert Path(f"{brain}.lock").stat().st_mode & 0o777 == 0o660


def test_a_brain_that_has_left_writes_nothing_any_more(brain: Path) -> None:
    writer = BrainWriter(ROBOT)
    writer.publish(1, [1], [[0.0]])
    writer.close()
    writer.close()
    for late in (lambda: writer.publish(2, [1], [[0.0]]), writer.beat, writer.press_estop):
        with pytest.raises(ShmError, match="has left"):
            late()
    assert plan()["plan_id"] == 1
    assert writer.mapping.load("estop") == 0


def test_threads_publish_one_after_the_other(brain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = BrainWriter(ROBOT)
    torn: list[int] = []

    class SlowShim:
        """Lets the other threads run in the middle of a plan's way to memory."""

        def lithe_channel_write(self, address: int, plan_address: int, size: int) -> None:
            time.sleep(0.002)
            if not (writer._plan["position_rad"] == writer._plan["plan_id"]).all():
                torn.append(int(writer._plan["plan_id"]))
            real.lithe_channel_write(address, plan_address, size)

        def __getattr__(self, name: str) -> object:
            return getattr(real, name)

    def publish(first: int) -> None:
        for number in range(first, first + 10):
            writer.publish(number, [number] * 16, np.full((16, 32), float(number)))

    real, slow = shm.shim(), SlowShim()
    monkeypatch.setattr(shm, "shim", lambda: slow)
    threads = [threading.Thread(target=publish, args=(i * 1000,)) for i in range(1, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert torn == []
    writer.close()


def test_a_mapping_knows_when_its_robot_was_started_anew(brain: Path) -> None:
    mapping = shm.Mapping(ROBOT, "brain", writable=False)
    assert mapping.is_current()
    brain.unlink()
    assert not mapping.is_current()
    make_file(ROBOT, "brain")
    assert not mapping.is_current()


def test_a_brain_that_was_killed_leaves_its_place(brain: Path) -> None:
    code = "from lithe.shm import BrainWriter; b = BrainWriter('arm'); print(1, flush=True); input()"
    env = os.environ | {"PYTHONPATH": str(Path(shm.__file__).parents[1])}
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1, env=env) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"1\n"
        with pytest.raises(ShmError, match=rf"already has a Brain \(pid {other.pid}\)"):
            BrainWriter(ROBOT)
        other.send_signal(signal.SIGKILL)
        other.wait()
    writer = BrainWriter(ROBOT)
    assert writer.mapping.header().epoch == 2
    writer.close()


def test_a_mailbox_is_full_when_nobody_takes_its_letters(brain: Path) -> None:
    mapping = shm.Mapping(ROBOT, "brain", writable=True)
    item, letters = mapping.item("commands")
    ack = np.zeros(16 + item.depth, np.uint64)  # tail on a line of its own, then the answers
    letter = Writer.record("Command", kind=int(_wire.CommandKind.arm), request_id=77)

    def send() -> int:
        return int(
            shm.shim().lithe_mailbox_send(letters, ack.ctypes.data, item.depth, letter.ctypes.data, letter.nbytes)
        )

    assert [send() for _ in range(item.depth)] == list(range(1, item.depth + 1))
    assert send() == 0
    ack[0] = 1
    assert send() == item.depth + 1
    poll = shm.shim().lithe_mailbox_poll
    assert poll(ack.ctypes.data, item.depth, 2) == _wire.CommandResult.pending
    ack[16 + 1] = 2 << 32 | int(_wire.CommandResult.refused_mode)
    assert poll(ack.ctypes.data, item.depth, 2) == _wire.CommandResult.refused_mode
    assert poll(ack.ctypes.data, item.depth, item.depth + 2) == _wire.CommandResult.pending, "an older letter's answer"
