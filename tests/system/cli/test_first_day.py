# SPDX-License-Identifier: Apache-2.0
"""What somebody meets on the first day: help, hints, moves by hand, and mistakes that are told at once."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import calm
import pytest
from system.robot_rig import BIN, ROOT, RobotRig

ANSI = "\x1b["


def test_a_wrong_word_is_named_with_the_nearest_right_one(rig: RobotRig) -> None:
    done = rig.lithe("stauts")
    assert (done.returncode, done.stdout) == (2, "")
    assert "did you mean 'status'?" in done.stderr and "next: all verbs: lithe help" in done.stderr
    assert "did you mean 'check'?" in rig.lithe("law", "chek").stderr
    assert rig.ask("stauts", code=2)["error"]["code"] == "unknown_verb"
    assert "lithe help swap" in rig.lithe("swap").stderr
    assert "lithe swap" in rig.lithe("help", "swap").stdout
    assert rig.lithe("help").stdout == rig.lithe("--help").stdout
    assert re.match(r"lithe \d+\.\d+\.\d+(\.dev\d+)?, layout [0-9a-f]{16}\n", rig.lithe("--version").stdout)


def test_the_manual_page_is_one(rig: RobotRig) -> None:
    page = rig.lithe("help", "--man").stdout
    groff = ["groff", "-man", "-wmac", "-Tascii"]
    done = subprocess.run(groff, input=page, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "lithe move [options] JOINT DEG" in re.sub(r".\x08", "", done.stdout)  # bold is struck twice


def test_bash_completes_verbs_options_and_files(rig: RobotRig) -> None:
    script = rig.lithe("help", "--bash").stdout

    def complete(*words: str) -> set[str]:
        line = " ".join(f"'{word}'" for word in ("lithe", *words))
        ask = f"{script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words)}; _lithe; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True, cwd=ROOT / "robots")
        return set(done.stdout.split())

    assert complete("sta") == {"status"}
    assert complete("law", "") >= {"check", "list", "show", "verify"}
    assert complete("--robot", "arm", "law", "ch") == {"check"}
    assert complete("swap", "--prob") == {"--probation"}
    assert "arm.toml" in complete("run", "ar")
    assert complete("status", "--units", "") == set()


def test_a_joint_is_moved_and_jogged_by_hand(arm: RobotRig) -> None:
    """Checked against its limits before anything moves."""
    rig = arm
    joint = rig.ask("status")["joints"][0]["name"]
    done = rig.ask("move", joint, "5", "--in", "1s")
    assert done["joint"] == joint and abs(done["to_rad"] - 0.0873) < 1e-3
    assert abs(done["position_rad"] - done["to_rad"]) < 0.2
    again = rig.ask("jog", joint, "-2.5", "--in", "500ms")
    assert again["from_rad"] == pytest.approx(done["to_rad"], abs=1e-6)
    assert again["to_rad"] == pytest.approx(done["to_rad"] - 0.0436, abs=1e-3)
    assert rig.ask("status")["plan"] == "hold" and rig.ask("status")["mode"] == "active"
    far = rig.ask("move", joint, "4000", code=1)["error"]
    assert far["code"] == "refused_range" and "its limits are" in far["message"]
    fast = rig.ask("jog", joint, "160", "--in", "100ms", code=1)["error"]
    assert fast["code"] == "refused_range" and "more time: --in" in fast["next"]
    assert rig.ask("move", joint[:-1] + "x", "1", code=1)["error"]["code"] == "unknown_joint"
    assert rig.ask("move", joint, "1", "--in", "60s", code=2)["error"]["code"] == "usage"
    rig.ask("swap", ROOT / "laws/hold.cpp", "--probation", "0")  # follows no setpoint
    stays = rig.ask("move", joint, "30", "--in", "1s", code=1)["error"]
    assert stays["code"] == "not_arrived" and "its target is 30.00 deg" in stays["message"], stays
    rig.ask("disarm")
    assert rig.ask("move", joint, "1", code=1)["error"]["code"] == "refused_mode"


def test_a_law_without_its_sensor_says_which_where_to_set_it_up_and_what_next(arm: RobotRig) -> None:
    """A reflex on a robot without sensors runs, and would never react."""
    rig = arm
    for words, value in (
        (("swap", "reflex"), -1),
        (("swap", "reflex", "--param", "sensor=1"), 1),
        (("param", "set", "sensor", "0"), 0),
    ):
        done = rig.lithe(*words)
        assert done.returncode == 0, done.stderr
        (said,) = [line for line in done.stdout.splitlines() if "sensor" in line and line.startswith("warning: ")]
        assert f"sensor = {value} is no sensor of this robot, which has none" in said
        assert (
            f"[[sensor]] in {rig.config}" in said and "docs/hardware.md" in said and "lithe param set sensor 0" in said
        )


# A zsh on a terminal of its own: what stands on its line after TAB.
ZSH = r"""
zmodload zsh/zpty
zpty shell zsh -f -i
zpty -w shell "PS1='> '; bindkey -e; autoload -Uz compinit; compinit -u -D; . $1; cd $2; print -n READ''Y"
zpty -r -m shell line '*READY*'
for words in "${@:3}"; do
  zpty -w -n shell "$words"$'\t'
  zpty -w -n shell $'\C-a'"print -r -- '<"$'\C-e'">'"$'\n'
  zpty -r -m shell line $'*\n<*>*'
  print -r -- "${${line##*$'\n'<}%%>*}"
done
"""


def test_a_zsh_completes_verbs_options_and_files(rig: RobotRig) -> None:
    """By a person's key, in a shell that has read the file."""
    if shutil.which("zsh") is None:
        pytest.skip("no zsh here (Debian: apt-get install zsh)")
    script = rig.dir / "_lithe"
    script.write_text(rig.lithe("help", "--zsh").stdout)
    typed = {
        "lithe mov": "lithe move",
        "lithe law ch": "lithe law check",
        "lithe --robot arm law ch": "lithe --robot arm law check",
        "lithe swap --prob": "lithe swap --probation",
        "lithe run chai": "lithe run chain.toml",
    }
    words = ["zsh", "-f", "-c", ZSH, "zsh", script, ROOT / "robots", *typed]
    env = rig.env | {"TERM": "xterm"}
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == list(typed.values())


STAYS = """
import sys, lithe
robot = lithe.connect("arm")
if robot.status()["mode"] == "safe_stop":
    robot.reset()
robot.arm()
robot.go_to([0.05], 0.5)
print("there", flush=True)
sys.stdin.readline()
"""


def test_a_robot_that_stops_without_its_brain_is_moved_by_one_that_stays(rig: RobotRig) -> None:
    """The command line says so, and what it says to do works."""
    rig.config.write_text(calm.changed(calm.calm_text(), {'on_stale = "hold"': 'on_stale = "safe_stop"'}, "the arm"))
    rig.run("--no-arm")
    rig.wait_for(lambda: rig.ask("status")["mode"] == "disarmed")
    joint = rig.ask("status")["joints"][0]["name"]
    alone = rig.ask("move", joint, "5", code=1)["error"]
    assert alone["code"] == "refused_brain" and 'on_stale = "safe_stop"' in alone["message"], alone
    assert "armed only while a Brain lives" in alone["message"] and "robot.go_to" in alone["next"]
    stopped = rig.ask("arm", code=3)["error"]
    assert stopped["code"] == "refused_fault" and stopped["detail"]["fault"] == "brain_stale", stopped
    assert rig.ask("status")["mode"] == "safe_stop"
    assert rig.ask("jog", joint, "5", code=1)["error"]["code"] == "refused_brain", "not: reset and arm it"
    env = rig.env | {"PYTHONPATH": str(ROOT / "brain")}
    pipe = subprocess.PIPE
    brain = subprocess.Popen([sys.executable, "-c", STAYS], env=env, stdin=pipe, stdout=pipe, text=True)
    rig.started.append(brain)
    assert brain.stdout is not None and brain.stdout.readline() == "there\n"
    rig.wait_for(lambda: abs(rig.ask("status")["joints"][0]["setpoint_position_rad"] - 0.05) < 1e-3)
    assert rig.ask("status")["mode"] == "active"
    beside = rig.ask("jog", joint, "5", code=1)["error"]
    assert beside["code"] == "refused_brain" and f"has a Brain already (pid {brain.pid})" in beside["message"]
    brain.communicate("\n")
    rig.wait_for(lambda: rig.ask("status")["fault"] == "brain_stale")


def test_the_status_begins_with_what_is_wrong_and_is_plain_in_a_pipe(arm: RobotRig) -> None:
    rig = arm
    said = rig.lithe("status").stdout
    assert ANSI not in said and "ALARM" not in said
    assert re.search(r"joint +position +setpoint +velocity +torque +limits +drive\n +deg +deg +deg/s +N m +deg\n", said)
    assert "rad/s" in rig.lithe("status", "--units", "rad").stdout
    rig.ask("estop")
    assert rig.lithe("status").stdout.splitlines()[1].startswith("  ALARM   the e-stop is latched")
    assert rig.ask("status")["alarms"][0]["level"] == "stop"
    env = rig.env | {"TERM": "xterm"}
    for more, colored in (({}, True), ({"NO_COLOR": "1"}, False)):
        shown = subprocess.run(
            ["script", "-qec", f"{BIN / 'lithe'} status", "/dev/null"],
            env=env | more, capture_output=True, text=True, check=True, timeout=60,
        ).stdout  # fmt: skip
        assert (ANSI in shown) is colored, shown


def test_the_list_names_every_robot_whoever_answers_for_it(rig: RobotRig) -> None:
    assert rig.ask("list") == {"robots": []}
    assert "no robot runs here" in rig.lithe("list").stdout
    process = rig.run()
    (arm,) = rig.ask("list")["robots"]
    wanted = {"robot": "arm", "supervisor": "answers", "mode": "active", "law": "pd", "ticks": True}
    assert {key: arm[key] for key in wanted} == wanted
    process.kill()
    process.wait()
    (alone,) = rig.ask("list")["robots"]
    assert (alone["supervisor"], alone["ticks"], alone["spine_pid"]) == ("none", True, arm["spine_pid"])
    os.kill(arm["spine_pid"], signal.SIGTERM)


def test_a_stopped_supervisor_is_named_and_a_question_changes_nothing(arm: RobotRig) -> None:
    """Ctrl-Z: the Spine ticks on, nobody answers, and nobody waits for it."""
    rig, process = arm, arm.started[0]
    spine = rig.ask("status")["spine_pid"]
    process.send_signal(signal.SIGSTOP)
    try:
        for verb in ("status", "arm", "stop", "top"):
            done = rig.lithe(verb)
            assert done.returncode == 1, verb
            assert f"(pid {process.pid}) is stopped (Ctrl-Z?), and nothing was asked of it" in done.stderr, verb
            assert f"(pid {spine}) ticks: mode active" in done.stderr and "may still take effect" not in done.stderr
            assert f"kill -CONT {process.pid}" in done.stderr
    finally:
        process.send_signal(signal.SIGCONT)
    rig.wait_for(lambda: rig.lithe("status").returncode == 0)
    assert rig.ask("status")["mode"] == "active", "none of them came through later"


@pytest.mark.parametrize("wrong", ["core", "joint"])
def test_a_file_that_this_machine_cannot_run_is_refused_before_a_compiler_starts(rig: RobotRig, wrong: str) -> None:
    """Exit 2, with what it may be instead, and no trace of lawd."""
    text = (ROOT / "robots" / "arm.toml").read_text()
    if wrong == "core":
        text = text.replace('cpu_spine = "auto"', "cpu_spine = 999", 1)
        says = "999"
    else:
        model = rig.dir / "model.xml"
        model.write_text(
            '<mujoco><worldbody><body><joint name="other" type="hinge"/><geom size="0.1"/></body></worldbody></mujoco>'
        )
        text = text.replace('kind = "independent"', f'kind = "mujoco"\nmodel = "{model}"', 1)
        told_by_the_model = "inertia_kg_m2|mgl_nm|viscous_\\w+|coulomb_nm|stribeck_\\w+|cogging_\\w+|payload_\\w+"
        text = re.sub(rf"(?m)^({told_by_the_model}) *=.*\n", "", text)
        says = "there is no joint"
    path: Path = rig.dir / "arm.toml"
    path.write_text(text.replace('"../laws/', f'"{ROOT}/laws/'))
    rig.config = path
    process = rig.run(wait=False)
    assert process.wait(60) == 2, rig.log()
    if wrong == "joint" and "built without MuJoCo" in rig.log():
        says = "built without MuJoCo"
    assert says in rig.log(), rig.log()
    assert "compiling" not in rig.log() and not (rig.dir / "run" / "arm.spine.log").exists()
    assert rig.segments() == []


def test_safe_gains_that_shake_the_simulated_robot_refuse_the_start(rig: RobotRig) -> None:
    """Exit 2, with joint, gain and what to write; the Spine was never started. The file's own check passes them."""
    text = (ROOT / "robots" / "arm.toml").read_text()
    changes = {
        "safe_kd_nm_s_rad = 0.04 ": "safe_kd_nm_s_rad = 0.3 ",
        "\ninertia_kg_m2 = 2.55e-3": "\ninertia_kg_m2 = 3e-4",
    }
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new)
    rig.config = rig.dir / "arm.toml"
    rig.config.write_text(text.replace('"../laws/', f'"{ROOT}/laws/'))
    process = rig.run(wait=False)
    assert process.wait(120) == 2, rig.log()
    assert "joint shoulder: safe_kd_nm_s_rad = 0.3 shakes it" in rig.log(), rig.log()
    assert "write safe_kd_nm_s_rad = " in rig.log(), rig.log()
    assert not (rig.dir / "run" / "arm.spine.log").exists()
    assert rig.segments() == []
