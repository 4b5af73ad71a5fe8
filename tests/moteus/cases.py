# SPDX-License-Identifier: Apache-2.0
"""Random commands, queries and answers as the maker's own library writes and reads them; a JSON case a line.

Run by Python with that library in its path. argv: how many, seed. Each case is a request to frames_peer and what the
library says is right, under "expect".
"""

import io
import json
import math
import random
import sys
from collections.abc import Callable
from typing import Any

import moteus
from moteus import multiplex as mp
from moteus.moteus import CurrentResolution
from moteus.protocol import Writer, parse_reply

LONGEST = 64
RUNS = [  # registers that a drive answers with, by the library's writer for each
    (0x000, ["int", "position", "velocity"]),
    (0x003, ["torque", "current", "current"]),
    (0x006, ["position", "power"]),
    (0x00A, ["temperature", "int", "int"]),
    (0x00D, ["voltage", "temperature", "int"]),
    (0x030, ["torque", "torque", "torque"]),
    (0x033, ["torque", "torque"]),
    (0x038, ["position", "velocity", "torque"]),
    (0x03B, ["position", "velocity", "torque"]),
    (0x050, ["position", "velocity", "position"]),
    (0x060, ["pwm", "pwm", "pwm"]),
    (0x068, ["pwm", "pwm"]),
]
POSITION_FIELDS = [
    "position",
    "velocity",
    "feedforward_torque",
    "kp_scale",
    "kd_scale",
    "maximum_torque",
    "stop_position",
    "watchdog_timeout",
    "velocity_limit",
    "accel_limit",
    "fixed_voltage_override",
    "ilimit_scale",
    "fixed_current_override",
    "ignore_position_bounds",
]
WITHIN_FIELDS = [
    "lower_bound",
    "upper_bound",
    "feedforward_torque",
    "kp_scale",
    "kd_scale",
    "maximum_torque",
    "watchdog_timeout",
    "ilimit_scale",
    "ignore_position_bounds",
]
QUERY_FIELDS = {
    "mode": 0,
    "position": 1,
    "velocity": 2,
    "torque": 3,
    "q_current": 4,
    "d_current": 5,
    "abs_position": 6,
    "power": 7,
    "motor_temperature": 10,
    "trajectory_complete": 11,
    "home_state": 12,
    "voltage": 13,
    "temperature": 14,
    "fault": 15,
}


class Cases:
    """Draws cases."""

    def __init__(self, seed: int) -> None:
        """One controller of the library, and one source of chance."""
        self.lot = random.Random(seed)
        self.controller = moteus.Controller(id=1, transport=object())

    def value(self) -> float:
        """Small, large, exact, not a number."""
        return self.lot.choice(
            [
                self.lot.uniform(-1, 1),
                self.lot.uniform(-40, 40),
                self.lot.uniform(-1e5, 1e5),
                self.lot.choice([0.0, -0.0, 0.1, 0.5, 1.0, -1.0, 1.27, 3.2767, 1e30, -1e30]),
                self.lot.choice([math.nan, math.inf, -math.inf]),
            ]
        )

    def resolution(self) -> int:
        """int8, int16, int32 or float."""
        return self.lot.randrange(4)

    def query(self) -> tuple[Any, list[dict[str, Any]]]:
        """A query of the library, and the parts that ask the same."""
        wanted = moteus.QueryResolution()
        for name in QUERY_FIELDS:
            setattr(wanted, name, self.lot.choice([mp.IGNORE, *range(4)]))
        parts = []
        for first, last in ((0, 7), (10, 15)):
            by_number = {number: getattr(wanted, name) for name, number in QUERY_FIELDS.items()}
            parts.append(read_part(first, [by_number[number] for number in range(first, last + 1)]))
        if self.lot.random() < 0.3:
            number = self.lot.choice([0x020, 0x030, 0x038, 0x050, 0x060, 0x070, 0x100, 0x150])
            wanted._extra = {number + i: self.resolution() for i in range(self.lot.randrange(1, 5))}
            parts.append(read_part(number, list(wanted._extra.values())))
        return wanted, parts

    def command(self) -> dict[str, Any]:
        """A command of any kind, with or without a query."""
        kind = self.lot.choice(["position", "position", "within", "stop", "brake", "zero", "output", "current"])
        wanted, reads = self.query() if self.lot.random() < 0.5 else (None, [])
        frame, parts = getattr(self, kind)(wanted)
        return {"do": "encode", "parts": parts + reads, "expect": {"hex": frame.data.hex()}}

    def fields(self, mode: int, start: int, names: list[str], resolutions: dict[str, int]) -> tuple[Any, Any]:
        """Some of these, with values; and the parts that write them."""
        chosen = {name: self.value() for name in names if self.lot.random() < 0.6}
        for name in chosen:
            if name == "ignore_position_bounds":
                chosen[name] = self.lot.randrange(2)
        formats = [resolutions[name] if name in chosen else None for name in names]
        values = [float(chosen.get(name, 0)).hex() for name in names]
        write = {"kind": "write", "start": start, "formats": formats, "values": values}
        return chosen, [mode_part(mode), write]

    def position(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 10."""
        self.controller.position_resolution = resolution = moteus.PositionResolution()
        for name in POSITION_FIELDS:
            setattr(resolution, name, self.resolution())
        chosen, parts = self.fields(10, 0x020, POSITION_FIELDS, vars(resolution))
        return self.controller.make_position(**chosen, query_override=wanted), parts

    def within(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 13."""
        self.controller.position_resolution = resolution = moteus.PositionResolution()
        for name in POSITION_FIELDS:
            setattr(resolution, name, self.resolution())
        formats = vars(resolution) | {"lower_bound": resolution.position, "upper_bound": resolution.position}
        chosen, parts = self.fields(13, 0x040, WITHIN_FIELDS, formats)
        return self.controller.make_stay_within(**chosen, query_override=wanted), parts

    def stop(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 0."""
        return self.controller.make_stop(query_override=wanted), [mode_part(0)]

    def brake(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 15."""
        return self.controller.make_brake(query_override=wanted), [mode_part(15)]

    def zero(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 12."""
        scale = self.value()
        write = {"kind": "write", "start": 0x024, "formats": [3], "values": [float(scale).hex()]}
        return self.controller.make_zero_velocity(kd_scale=scale, query_override=wanted), [mode_part(12), write]

    def output(self, wanted: Any) -> tuple[Any, Any]:
        """Registers above 127, whose number takes two bytes."""
        position = self.value()
        nearest = self.lot.random() < 0.5
        make: Callable[..., Any] = (
            self.controller.make_set_output_nearest if nearest else self.controller.make_set_output_exact
        )
        start = 0x130 if nearest else 0x131
        write = {"kind": "write", "start": start, "formats": [3], "values": [float(position).hex()]}
        return make(position=position, query_override=wanted), [write]

    def current(self, wanted: Any) -> tuple[Any, Any]:
        """Mode 9."""
        self.controller.current_resolution = resolution = CurrentResolution()
        resolution.d_A, resolution.q_A = self.resolution(), self.resolution()
        d, q = self.value(), self.value()
        write = {
            "kind": "write",
            "start": 0x01C,
            "formats": [resolution.q_A, resolution.d_A],
            "values": [float(q).hex(), float(d).hex()],
        }
        return self.controller.make_current(d_A=d, q_A=q, query_override=wanted), [mode_part(9), write]

    def stream(self) -> dict[str, Any]:
        """The diagnostic stream."""
        if self.lot.random() < 0.5:
            most = self.lot.randrange(1, 62)
            frame = self.controller.make_diagnostic_read(max_length=most)
            parts = [{"kind": "poll", "channel": 1, "most": most}]
        else:
            data = self.lot.randbytes(self.lot.randrange(1, 48))
            frame = self.controller.make_diagnostic_write(data=data)
            parts = [{"kind": "data", "channel": 1, "hex": data.hex()}]
        return {"do": "encode", "parts": parts, "expect": {"hex": frame.data.hex()}}

    def query_only(self) -> dict[str, Any]:
        """A query without a command."""
        wanted, parts = self.query()
        return {"do": "encode", "parts": parts, "expect": {"hex": self.controller.make_query(wanted).data.hex()}}

    def answer(self) -> list[dict[str, Any]]:
        """What a drive might say: bytes that the library writes, how it reads them, and the numbers they came from."""
        buffer = io.BytesIO()
        writer = Writer(buffer)
        parts = []
        runs = [run for run in RUNS if self.lot.random() < 0.3] or [RUNS[0]]
        for start, names in runs:
            resolution = self.resolution()
            count = self.lot.randrange(1, min(len(names), 3) + 1)
            writer.write_int8(mp.REPLY_BASE | resolution << 2 | count)
            writer.write_varuint(start)
            values = []
            for name in names[:count]:
                value = float(self.lot.randrange(100)) if name == "int" else self.value()
                getattr(writer, f"write_{name}")(value, resolution)
                values.append(value.hex())
            parts.append({"kind": "reply", "start": start, "formats": [resolution], "values": values})
        data = buffer.getvalue()
        replies = [[int(number), float(value).hex()] for number, value in parse_reply(data).items()]
        expect = {"replies": replies, "errors": [], "ok": True}
        back = {"do": "encode", "parts": parts, "expect": {"hex": data.hex()}}
        return [{"do": "decode", "hex": data.hex(), "expect": expect}, back]

    def driven(self) -> dict[str, Any]:
        """A frame of our own driver, as the library would send the same command."""
        turn = 2 * math.pi
        # Of a command, of an answer, of current and power.
        formats = [self.resolution(), self.resolution(), *(self.lot.choice([None, 0, 1, 2, 3]) for _ in range(2))]
        settings = self.lot.random() < 0.7  # in the command, else the drive's own
        command = {
            "action": self.lot.choice([0, 1, 1, 1, 2, 3]),
            "position_rad": self.lot.choice([math.nan, self.lot.uniform(-1, 1) * turn]),
            "velocity_rad_s": self.lot.uniform(-20, 20),
            "torque_nm": self.lot.uniform(-2, 2),
            "kp_nm_rad": self.lot.uniform(0, 30),
            "kd_nm_s_rad": self.lot.uniform(0, 1),
            "max_torque_nm": self.lot.uniform(0, 3),
        }
        watchdog = self.lot.choice([0.02, 0.1, 0.2])
        frame = self.same(command, formats, watchdog if settings else None)
        texts = {key: value if key == "action" else float(value).hex() for key, value in command.items()}
        params = {"id": 1, "watchdog_s": watchdog.hex(), "formats": formats, "settings": settings}
        expect = {"hex": frame.data.hex(), "id": 0x8001, "ok": True}
        return {"do": "drive", "params": params, "command": texts, "padded": True, "expect": expect}

    def same(self, c: dict[str, Any], formats: list[int | None], watchdog: float | None) -> Any:
        """The library's frame for a joint that is its motor, and a drive with the factory's gains.

        Without a watchdog time all settings are the drive's own.
        """
        turn = 2 * math.pi
        wanted = moteus.QueryResolution()
        sent, answer = formats[:2]
        wanted.position = wanted.velocity = wanted.torque = answer
        wanted.q_current, wanted.power = (mp.IGNORE if each is None else each for each in formats[2:])
        wanted.mode = mp.INT16 if answer == mp.INT16 else mp.INT8
        wanted.home_state = mp.INT8
        self.controller.position_resolution = r = moteus.PositionResolution()
        r.position = r.velocity = r.feedforward_torque = r.kp_scale = r.kd_scale = r.maximum_torque = sent
        r.watchdog_timeout = mp.INT16
        r.velocity_limit = r.accel_limit = r.ilimit_scale = mp.INT8
        gain = 1 / (1 / turn)
        scales = {
            "feedforward_torque": c["torque_nm"],
            "kp_scale": c["kp_nm_rad"] * gain / 4.0,
            "kd_scale": c["kd_nm_s_rad"] * gain / 0.05,
            "maximum_torque": c["max_torque_nm"],
            "query_override": wanted,
        }
        limits = {}
        if watchdog is not None:
            scales |= {"watchdog_timeout": watchdog, "ilimit_scale": 0.0}
            limits = {"velocity_limit": -1.0, "accel_limit": -1.0}
        rev = 1 / turn
        if c["action"] == 1:
            if math.isnan(c["position_rad"]):
                scales["kp_scale"] = 0.0
            motion = {"position": c["position_rad"] * rev, "velocity": c["velocity_rad_s"] * rev}
            return self.controller.make_position(**motion, **scales, **limits)
        make = {0: self.controller.make_stop, 2: self.controller.make_zero_velocity, 3: self.controller.make_brake}
        return make[c["action"]](query_override=wanted)


def mode_part(mode: int) -> dict[str, Any]:
    """The write of a mode."""
    return {"kind": "write", "start": 0, "formats": [0], "values": [float(mode).hex()]}


def read_part(start: int, resolutions: list[int]) -> dict[str, Any]:
    """Reads from one register on."""
    return {"kind": "read", "start": start, "formats": [None if each == mp.IGNORE else each for each in resolutions]}


def main() -> None:
    """Prints the cases."""
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    cases = Cases(seed)
    for _ in range(count):
        kind = cases.lot.random()
        if kind < 0.4:
            made = [cases.command()]
        elif kind < 0.5:
            made = [cases.query_only()]
        elif kind < 0.6:
            made = [cases.stream()]
        elif kind < 0.8:
            made = cases.answer()
        else:
            made = [cases.driven()]
        for case in made:
            if len(case["expect"].get("hex", "")) <= 2 * LONGEST:  # the library leaves it to the bus to refuse
                print(json.dumps(case))


if __name__ == "__main__":
    main()
