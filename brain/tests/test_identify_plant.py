# SPDX-License-Identifier: Apache-2.0
"""A robot file with the plant that was found: it moves as was found, and nothing else in it is changed."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from lithe.errors import LitheError
from lithe.identify.chain import ChainFit, Parameter
from lithe.identify.plant import Value, Values, chain_values, plant_of, with_values, write_new

ROOT = Path(__file__).resolve().parents[2]
CHAIN = (ROOT / "robots/chain.toml").read_text(encoding="utf-8")
LENGTH_M = np.array([0.25, 0.2, 0.12])
ROTOR_KG_M2 = 2.0e-3


def sums(mass: np.ndarray, centre: np.ndarray, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moment and inertia about the joint of each link, as regressor.py defines them."""
    beyond = np.array([mass[k + 1 :].sum() for k in range(3)])
    about = inertia + mass * centre**2 + beyond * LENGTH_M**2
    about[0] += ROTOR_KG_M2
    return mass * centre + beyond * LENGTH_M, about


def fit_of(moment: np.ndarray, about: np.ndarray) -> ChainFit:
    found = []
    for k, name in enumerate(("shoulder", "elbow", "wrist")):
        values = {"moment": moment[k], "inertia": about[k], "viscous": 0.03, "coulomb": -1e-4, "rotor": ROTOR_KG_M2}
        found += [
            Parameter(name, what, "", float(value), 1e-4) for what, value in values.items() if k or what != "rotor"
        ]
    return ChainFit(tuple(found), {}, 1.0, 100, ())


def written(text: str, values: Values) -> dict[str, np.ndarray]:
    """Of each key the values of all joints."""
    sims = [joint["sim"] for joint in tomllib.loads(with_values(text, values))["joint"]]
    return {key: np.array([sim[key] for sim in sims]) for key in ("mass_kg", "center_m", "link_inertia_kg_m2")}


@pytest.mark.parametrize("payload_kg", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("first_kg", [0.35, 3.0])
def test_the_links_that_are_written_move_as_those_that_were_found(payload_kg: float, first_kg: float) -> None:
    """Also where the file's own first mass and centres cannot be kept, because the robot is another one."""
    mass, inertia = np.array([first_kg, 0.25, 0.08 + payload_kg]), np.array([2.5e-3, 1.2e-3, 1e-4])
    moment, about = sums(mass, np.array([0.05 if first_kg > 1 else 0.16, 0.13, 0.1]), inertia)
    now = written(CHAIN, chain_values(plant_of(CHAIN), fit_of(moment, about)))
    assert min(now["mass_kg"]) > 0 and min(now["link_inertia_kg_m2"]) >= 0
    again = sums(now["mass_kg"], now["center_m"], now["link_inertia_kg_m2"])
    assert again[0] == pytest.approx(moment, rel=1e-4) and again[1] == pytest.approx(about, rel=1e-4)
    if first_kg < 1:
        assert now["mass_kg"] == pytest.approx(mass, rel=1e-4), "where they can be kept, it is the same robot"


def test_what_no_links_have_is_refused() -> None:
    moment, about = sums(np.array([0.35, 0.25, 0.08]), np.array([0.16, 0.13, 0.06]), np.zeros(3))
    with pytest.raises(LitheError, match="no links have the moments"):
        chain_values(plant_of(CHAIN), fit_of(moment, 0.5 * about))


def test_every_other_line_and_every_comment_stays() -> None:
    text = re.sub(r"(?ms)^\[joint\.model\].*?(?=^\[)", "", CHAIN)  # which has some of the same lines, and stays
    text = text.replace("mass_kg = 0.08", "mass_kg = 0.08\npayload_kg = 0.02")
    moment, about = sums(np.array([0.35, 0.25, 0.08]), np.array([0.16, 0.13, 0.06]), np.full(3, 1e-3))
    now = with_values(text, chain_values(plant_of(text), fit_of(moment, about))).splitlines()
    before = text.splitlines()
    gone = [line for line in before if line not in now]
    assert {line.split(" = ")[0] for line in gone} == {"mass_kg", "center_m", "link_inertia_kg_m2", "payload_kg"}
    for line in gone:
        assert "#" not in line or any(line.split("# ")[1] in each for each in now)
    assert "coulomb_nm = 0.0  # identified: 0 to 9.6e-05" in now
    assert "payload_kg = 0.0  # identified: it is in the other values" in now
    assert [each for each in now if each in before] == [each for each in before if each in now], "in the same order"


def test_forms_that_cannot_be_changed_are_refused_and_a_missing_table_is_made() -> None:
    head = '[[joint]]\nname = "a"\n# a comment\n'
    values = {"a": {"mgl_nm": Value(0.5)}}
    assert with_values(f"{head}\n[x]\ny = 1\n", values) == (
        '[[joint]]\nname = "a"\n[joint.sim]\nmgl_nm = 0.5  # identified\n# a comment\n\n[x]\ny = 1\n'
    )
    for inline in ("sim = { mgl_nm = 0.1 }\n", "sim.mgl_nm = 0.1\n"):
        with pytest.raises(LitheError, match=r"a table \[joint.sim\] of its own"):
            with_values(head + inline, values)


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "out.toml"
    write_new(path, "a = 1\n")
    with pytest.raises(LitheError, match="stays as it is"):
        write_new(path, "b = 2\n")
    assert path.read_text() == "a = 1\n"
    with pytest.raises(LitheError, match="a folder that is there"):
        write_new(tmp_path / "none" / "out.toml", "")
