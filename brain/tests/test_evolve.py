# SPDX-License-Identifier: Apache-2.0
"""The search of laws and parameters, on the programs that a swap goes through."""

import json
import os
import re
import signal
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import calm
import numpy as np
import pytest
from chain_sim import STEP_S, Chains, as_recorded
from lithe.evolve.__main__ import Progress, main
from lithe.gateway.references import References, curve_of
from system.robot_rig import BIN, ROOT, need

CHAIN, PD, GRAVITY = ROOT / "robots/chain.toml", ROOT / "laws/pd.cpp", ROOT / "laws/gravity_pd.cpp"
BUDGET = 64
EVOLVE = [sys.executable, "-m", "lithe.evolve"]
SEARCH = [*EVOLVE, CHAIN, PD, GRAVITY, "--budget", str(BUDGET), "--out"]
# Whatever its parameter is, it pushes each joint away from its setpoint.
WRONG = """
#include <lithe/law.hpp>
struct Wrong {
  struct Params {
    lithe::Param kp_nm_rad{30, 20, 40};
  };
  struct State {};
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.kp_nm_rad * (t.position_rad[j] - t.setpoint_position_rad[j] + 0.1);
    }
  }
};
LITHE_LAW(Wrong, "wrong");
"""
# It leaves the joint alone: a trial accepts that, a probation in motion does not.
LIMP = """
#include <lithe/law.hpp>
struct Limp {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = -0.02 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Limp, "limp");
"""


@pytest.fixture(autouse=True)
def programs(monkeypatch: pytest.MonkeyPatch) -> None:
    need("lawd", "lithe-trial")
    monkeypatch.setenv("LITHE_BIN_DIR", str(BIN))
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "brain"))


def search(out: Path, *words: str | Path) -> dict[str, Any]:
    """The result of a search by command."""
    done = evolve(out, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    result: dict[str, Any] = json.loads((out / "result.json").read_text())
    return result


def evolve(out: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PYTHONPATH": str(ROOT / "brain")}
    return subprocess.run([*SEARCH, out, *words], env=env, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The search in one process."""
    return search(tmp_path_factory.mktemp("alone"), "--seed", "7")


def test_it_is_better_than_the_defaults(alone: dict[str, Any], tmp_path: Path, tell: Any) -> None:
    assert {one["law"] for one in alone["best"]} == {"pd.cpp", "gravity_pd.cpp"} and alone["candidates"] == BUDGET
    done = evolve(tmp_path, "--budget", "1")
    default = json.loads((tmp_path / "result.json").read_text())["winner"]
    assert done.returncode == 0 and default["params"]["kp_nm_rad"] == 4.0, "the first candidate has the defaults"
    tell(f"from {default['score']['value']:.4f} rad to {alone['winner']['score']['value']:.4f} rad")
    assert alone["winner"]["score"]["value"] < 0.6 * default["score"]["value"]


def test_two_processes_find_the_same_winner(alone: dict[str, Any], tmp_path: Path) -> None:
    assert search(tmp_path, "--seed", "7", "--processes", "2") == alone


def test_a_dask_cluster_finds_the_same_winner(alone: dict[str, Any], tmp_path: Path) -> None:
    assert search(tmp_path, "--seed", "7", "--dask", "--processes", "2") == alone


def test_another_seed_draws_other_candidates(alone: dict[str, Any], tmp_path: Path) -> None:
    assert search(tmp_path, "--seed", "8", "--budget", "32")["winner"] != alone["winner"]


def test_a_killed_search_is_resumed_and_finds_the_same_winner(alone: dict[str, Any], tmp_path: Path) -> None:
    with subprocess.Popen([*SEARCH, tmp_path, "--seed", "7"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("24 of"):
                process.send_signal(signal.SIGKILL)
                break
        process.wait()
    journal = tmp_path / "journal.jsonl"
    whole = len(journal.read_text().splitlines())
    assert 24 < whole <= BUDGET, "it was killed half-way"
    journal.write_text(journal.read_text() + '{"law": "pd.c')  # the last line was being written
    assert search(tmp_path, "--seed", "7", "--resume") == alone
    assert len(journal.read_text().splitlines()) == BUDGET + 1
    other = evolve(tmp_path, "--seed", "9", "--resume")
    assert other.returncode == 2 and "seed differ" in other.stderr


def test_refused_candidates_are_counted_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    law = tmp_path / "wrong.cpp"
    law.write_text(WRONG)
    assert main([str(CHAIN), str(law), "--budget", "16", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["winner"] is None and sum(result["refused"].values()) == 16
    assert "every candidate was refused" in said and "refused" in said.splitlines()[-2]


def test_a_winner_on_the_robot_is_told_with_its_verdict_and_one_that_is_rolled_back_is_none(tmp_path: Path) -> None:
    law = tmp_path / "limp.cpp"
    law.write_text(LIMP)
    with calm.calm_robot() as rig, calm.connected() as robot:

        def live(source: Path) -> subprocess.CompletedProcess[str]:
            command = [*EVOLVE, rig.config, source, "--budget", "1", "--live", "--out", tmp_path / source.stem]
            return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)

        References(robot).set(
            {"kind": "sine", "centre_rad": 0.9, "amplitude_rad": 0.4, "frequency_hz": 1.0, "stay": True}
        )
        kept, back = live(PD), live(law)
        assert robot.status()["law"] == "pd"
    assert kept.returncode == 0 and ("live: confirmed" in kept.stdout or "live: unproven" in kept.stdout), kept
    assert re.search(r"joint shoulder: [0-9.e-]+ rad, under the law before [0-9.e-]+ rad", kept.stdout), kept.stdout
    assert back.returncode == 1 and "live: rolled_back" in back.stdout, back.stdout + back.stderr
    assert "live: rolled back: tracking_lost: joint shoulder" in back.stdout, back.stdout


def test_on_a_terminal_one_line_is_written_again_and_elsewhere_a_line_for_each_batch(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ours, its = os.openpty()
    termios.tcsetwinsize(its, (24, 60))
    with os.fdopen(its, "w") as terminal:
        progress = Progress(16, terminal)
        for done in (8, 16):
            progress(done, "pd.cpp: best 0.02 rad, 0 refused and words that no terminal of this width has room for")
        progress.close()
        progress.close()
        seen = ""
        while not seen.endswith("\r\n"):  # a terminal may give it in parts
            seen += os.read(ours, 4096).decode()
    os.close(ours)
    first, second = seen.split("\r\033[K")[1:]
    assert first.startswith(f"[{'#' * 12}{'.' * 12}] 8 of 16: pd.cpp") and len(first) == 59
    assert second.startswith(f"[{'#' * 24}] 16 of 16") and seen.count("\n") == 1 and seen.endswith("\r\n")
    plain = Progress(16, sys.stdout)
    plain(8, "pd.cpp")
    plain(16, "pd.cpp")
    plain.close()
    assert capsys.readouterr().out == "8 of 16: pd.cpp\n16 of 16: pd.cpp\n"


def test_laws_are_searched_on_the_robot_as_it_was_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a chain with another load than its file's; the score is what a search on the identified file finds."""
    made = Chains.drawn(1, 3, seed=11)
    curve = curve_of(
        {"kind": "multisine", "centre_rad": 0.1, "amplitude_rad": 1.1, "frequency_hz": [0.3, 0.7, 1.1, 1.9]}, 3
    )
    (motion,) = made.follow(curve(np.arange(6000) * STEP_S))
    records = as_recorded(motion)
    np.save(tmp_path / "motion.npy", records)
    chain, lengths = tmp_path / "chain.toml", iter(map(float, made.length_m[0]))
    text = re.sub(r"length_m = [0-9.]+", lambda _: f"length_m = {next(lengths)!r}", CHAIN.read_text())
    chain.write_text(text)
    words = ["--budget", "8", "--seed", "3"]
    assert main([str(chain), str(PD), *words, "--recorded", str(tmp_path / "motion.npy"), "--out", str(tmp_path)]) == 0
    assert "windows, condition number" in capsys.readouterr().out
    found = json.loads((tmp_path / "result.json").read_text())["winner"]["score"]
    for robot, same in ((tmp_path / "recorded.toml", True), (chain, False)):
        out = tmp_path / f"again{same}"
        assert main([str(robot), str(PD), *words, "--out", str(out)]) == 0
        assert (json.loads((out / "result.json").read_text())["winner"]["score"] == found) == same
    still = records[:200]
    np.save(tmp_path / "still.npy", still)
    assert main([str(chain), str(PD), "--recorded", str(tmp_path / "still.npy"), "--out", str(tmp_path / "no")]) == 2
    assert "next: record a motion that tells more" in capsys.readouterr().err
    modelled = tmp_path / "modelled.toml"
    modelled.write_text(text.replace('kind = "chain"', 'kind = "mujoco"\nmodel = "arm.xml"'))
    out = tmp_path / "modelled"
    assert main([str(modelled), str(PD), "--recorded", str(tmp_path / "motion.npy"), "--out", str(out)]) == 2
    assert 'a plant of kind "mujoco" has its parameters in its model file' in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([ROOT / "README.md", PD], "is no robot file"),
        ([CHAIN, ROOT / "laws/missing.cpp"], "laws/missing.cpp: No such file"),
        ([CHAIN, ROOT / "robots/arm.toml"], "robots/arm.toml is not taken for a law: its name does not end in .cpp"),
        ([PD, CHAIN], "next: one robot file, then laws: lithe evolve ROBOT.toml LAW.cpp"),
        ([PD, GRAVITY], "next: one robot file, then laws: lithe evolve ROBOT.toml LAW.cpp"),
        ([CHAIN, "pd"], "pd is not taken for a law"),
        ([CHAIN, PD, "--out", ROOT / "README.md"], "cannot write to"),
        ([CHAIN, PD, "--resume"], "nothing to resume"),
    ],
)
def test_bad_input_is_named(
    words: list[str | Path], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--out", str(tmp_path), *map(str, words)]) == 2
    said = capsys.readouterr().err
    assert says in said and len(said.splitlines()) == 2 and "next: " in said


def test_one_that_is_interrupted_says_how_it_goes_on(tmp_path: Path) -> None:
    """Ctrl-C, without a traceback."""
    words = [*EVOLVE, CHAIN, PD, "--budget", "100000", "--out", tmp_path]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        running.stdout.readline()
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    assert (running.returncode, said.splitlines()[0]) == (130, "lithe.evolve: interrupted"), said
    assert "--resume" in said and "Traceback" not in said


def test_a_law_that_does_not_compile_is_told_as_the_compiler_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    law = tmp_path / "bad.cpp"
    law.write_text(PD.read_text().replace("kp_nm_rad *", "kq_nm_rad *"))
    assert main([str(CHAIN), str(law), "--out", str(tmp_path)]) == 2
    assert "kq_nm_rad" in capsys.readouterr().err
