# SPDX-License-Identifier: Apache-2.0
"""The robot of a soak: `lithe sim` with its devices, `lithe run`, and a Brain; all started here, ended by id.

Threads: start and end processes from the main thread only (the kernel ends a child with the thread that made it).
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import IO, Any

from lithe.control import Client, connect_control
from lithe.demo.processes import DIE_WITH_US, LEAVE_WITH_US, port_of, undisturbed
from lithe.errors import LitheError, Refused
from lithe.programs import binary
from lithe.remote import Remote
from lithe.shm import SpineView

from .judge import Broken, Judge

START_S = 120.0
ANSWER_S = 180.0
# A simulated drive is a process among others here, and loads and faults of the machine are part of the soak.
PATIENCE = {
    "spine": {"release": '"sleep"', "late_ticks_to_stop": "1000"},
    "guard": {"lost_after_misses": "300"},
    "brain": {"stale_after_s": "1.0"},
}
WATCHDOG_S = 2.0


def with_key(text: str, table: str, key: str, value: str) -> str:
    """TOML text in which this key of a table has this value; both are made where they are missing."""
    head = re.search(rf"^\[{re.escape(table)}\].*\n", text, re.M)
    if head is None:
        return f"{text.rstrip()}\n\n[{table}]\n{key} = {value}\n"
    after = re.search(r"^\[", text[head.end() :], re.M)
    end = head.end() + after.start() if after else len(text)
    body, found = re.subn(rf"^{key}\s*=.*$", f"{key} = {value}", text[head.end() : end], flags=re.M)
    return text[: head.end()] + ("" if found else f"{key} = {value}\n") + body + text[end:]


def at_terminals(text: str, robot_file: Path, links: Path) -> str:
    """A robot file whose simulated buses are at the terminals of a `lithe sim`, and which is patient."""

    def moved(match: re.Match[str]) -> str:
        bus = tomllib.loads(match[0])["bus"][0]
        if bus["kind"] != "loop":
            raise LitheError(
                f"bus '{bus['name']}' of {robot_file} is not simulated\n  next: a robot with kind = 'loop'"
            )
        kind = "slcan" if bus.get("data_bitrate") == 0 else "fdcanusb"
        return re.sub(r"^kind\s*=.*$", f'kind = "{kind}"\npath = "{links / bus["name"]}"', match[0], flags=re.M)

    text = re.sub(r"^\[\[bus\]\].*?(?=^\[|\Z)", moved, text, flags=re.M | re.S)
    text = re.sub(r"^watchdog_s\s*=.*$", f"watchdog_s = {WATCHDOG_S}", text, flags=re.M)
    law = tomllib.loads(text)["law"]
    text = re.sub(r"^law\s*=.*$", f'law = "{(robot_file.parent / law).resolve()}"', text, flags=re.M)
    for table, keys in PATIENCE.items():
        for key, value in keys.items():
            text = with_key(text, table, key, value)
    return text


class Rig:
    """The processes, and the verbs that they are asked; every answer is judged."""

    def __init__(self, robot_file: Path, out: Path, judge: Judge) -> None:
        self.out, self.judge = out.resolve(), judge
        self.folder = Path(tempfile.mkdtemp(prefix="lithe-soak-"))
        self.prefix = f"lithe-soak-{os.getpid()}"
        variables = {"RUN_DIR": self.folder / "run", "SHM_PREFIX": self.prefix, "OUT_DIR": self.out}
        os.environ.update({f"LITHE_{name}": str(value) for name, value in variables.items()})
        os.environ["LITHE_CACHE_DIR"] = str(self.out / "cache")
        text = at_terminals(robot_file.read_text(encoding="utf-8"), robot_file, self.folder / "buses")
        self.config = tomllib.loads(text)
        self.name = str(self.config["name"])
        self.file = self.folder / robot_file.name
        self.file.write_text(text, encoding="utf-8")
        self.log: IO[str] = (out / "run.log").open("a", encoding="utf-8")
        self.processes: dict[str, subprocess.Popen[Any]] = {}
        self._client: Client | None = None
        self.spine_pid = 0  # 0: not running, or about to be killed on purpose

    @property
    def swaps(self) -> Path:
        """The folder of the certificates."""
        return self.out / self.name / "swaps"

    def start(self) -> None:
        """All of it, until the robot is there."""
        sim = [*DIE_WITH_US, str(binary("lithe")), "sim", str(self.file), "--link", str(self.folder / "buses")]
        self.processes["sim"] = subprocess.Popen(
            sim, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.log, text=True
        )
        until = time.monotonic() + START_S
        while not all((self.folder / "buses" / bus["name"]).exists() for bus in self.config["bus"]):
            if self.processes["sim"].poll() is not None or time.monotonic() > until:
                raise LitheError(f"lithe sim did not start\n  next: see {self.log.name}")
            time.sleep(0.05)
        self.run()

    def run(self) -> None:
        """`lithe run`, which adopts a Spine that ticks; returns when it answers."""
        command = [*LEAVE_WITH_US, str(binary("lithe")), "run", str(self.file)]
        self.processes["run"] = subprocess.Popen(command, stdout=self.log, stderr=self.log, text=True)
        until = time.monotonic() + START_S
        while True:
            if self.processes["run"].poll() is not None or time.monotonic() > until:
                raise Broken(
                    "processes", f"`lithe run` does not answer (exit {self.processes['run'].poll()}): see run.log"
                )
            with contextlib.suppress(LitheError):
                self._client = connect_control(self.name, ANSWER_S)
                status = self._client.call("status", {})
                break
            time.sleep(0.1)
        if self.spine_pid and (not status["adopted"] or int(status["spine_pid"]) != self.spine_pid):
            told = f"Spine {status['spine_pid']}, adopted: {status['adopted']}"
            raise Broken("processes", f"Spine {self.spine_pid} ticks, and the new supervisor has {told}")
        if not self.spine_pid:
            self.spine = SpineView(self.name)
            self.spine_pid = int(status["spine_pid"])

    def start_brain(self) -> str:
        """A Brain that streams a sine of an eighth of each joint's range; an earlier one is ended.

        Returns "", or the code with which the sine was refused: the robot may have stopped since.
        """
        self.end("brain")
        info = self.spine.info
        count = int(info["joint_count"])
        low, high = info["position_min_rad"][:count], info["position_max_rad"][:count]
        sine = {"kind": "sine", "centre_rad": ((low + high) / 2).tolist(), "amplitude_rad": ((high - low) / 8).tolist()}
        sine |= {"frequency_hz": 0.25, "ramp_s": 2.0}
        token = self.folder / "token"
        words = ["-m", "lithe.gateway", "--robot", self.name, "--port", "0", "--token-file", str(token)]
        brain = self.processes["brain"] = subprocess.Popen(
            [*DIE_WITH_US, sys.executable, *words], bufsize=0, stdout=subprocess.PIPE, stderr=self.log,
            env=os.environ | {"LITHE_BRAIN_CPU": str(int(info["cpu_brain"]))},
        )  # fmt: skip
        try:
            with Remote("127.0.0.1", port_of(brain, START_S), token) as remote:
                remote.call("set_reference", **sine, stay=True)
        except Refused as refused:
            return refused.code
        except LitheError as why:
            raise Broken("processes", f"a new Brain did not get the robot ({why}): see run.log") from None
        return ""

    def ask(self, verb: str, **args: Any) -> tuple[str, Any]:
        """ "ok" and the result of a verb, or the code of its refusal and its detail."""
        assert self._client is not None
        try:
            code, told = "ok", self._client.call(verb, args)
        except Refused as refused:
            code, told = refused.code, refused.detail
        except LitheError as error:
            raise Broken("answers", f"'{verb}' was not answered: {error}") from None
        self.judge.answer(verb, code)
        return code, told

    def status(self) -> dict[str, Any]:
        """What the verb `status` has."""
        code, told = self.ask("status")
        if code != "ok":
            raise Broken("answers", f"'status' was refused with '{code}'")
        result: dict[str, Any] = told
        return result

    def order(self, **words: Any) -> None:
        """An order to `lithe sim`."""
        sim = self.processes["sim"]
        assert sim.stdin is not None and sim.stdout is not None
        sim.stdin.write(json.dumps(words) + "\n")
        sim.stdin.flush()
        while not (line := sim.stdout.readline()).startswith("{"):
            if not line:
                raise Broken("processes", f"lithe sim ended with {sim.wait()}: see run.log")
        if not json.loads(line).get("ok"):
            raise LitheError(f"lithe sim refused {words}: {line}")

    def kill_spine(self) -> int:
        """On purpose; returns the exit code of `lithe run`, which ends then."""
        pid, self.spine_pid = self.spine_pid, 0
        os.kill(pid, signal.SIGKILL)
        try:
            return self.processes["run"].wait(START_S)
        except subprocess.TimeoutExpired:
            raise Broken("processes", f"`lithe run` goes on {START_S:.0f} s after its Spine was killed") from None

    def kill_supervisor(self) -> None:
        """On purpose; its Spine goes on."""
        self.end("run")

    def end(self, name: str, number: int = signal.SIGKILL) -> None:
        """Ends a process that was started here."""
        process = self.processes.pop(name, None)
        if process is None:
            return
        if process.poll() is None:
            process.send_signal(number)
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()

    def close(self) -> None:
        """Ends all of it, the robot in order; a Spine without a supervisor, too."""
        with undisturbed():
            self.end("brain")
            alone = self.spine_pid if "run" not in self.processes else 0
            self.end("run", signal.SIGINT)
            if alone:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(alone, signal.SIGTERM)
            self.end("sim", signal.SIGTERM)
            for path in Path("/dev/shm").glob(f"{self.prefix}.*"):
                path.unlink(missing_ok=True)
            shutil.rmtree(self.folder, ignore_errors=True)
            self.log.close()
