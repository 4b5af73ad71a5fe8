# SPDX-License-Identifier: Apache-2.0
"""The simulated plant is no client's to read: every verb and document of a robot with numbers of its own."""

import json
import re
from collections.abc import Iterator
from typing import Any

import calm
import lithe
import pytest
from lithe.gateway import Gateway
from lithe.gateway.parts import chain_of
from lithe.gateway.token import lower
from lithe.mcp import library
from lithe.remote import Remote
from lithe.vocabulary import VERBS, Effect, Tier
from system.robot_rig import ROOT

CHANGES = {
    "\ninertia_kg_m2 = 2.55e-3 ": "\ninertia_kg_m2 = 2.56789e-3 ",
    "\nmgl_nm = 0.165 ": "\nmgl_nm = 0.165037 ",
    "\ncoulomb_nm = 0.0132 ": "\ncoulomb_nm = 0.0132171 ",
    "\ncogging_nm = 0.013 ": "\ncogging_nm = 0.0130917 ",
    "\ntorque_gain_error = 0.05 ": "\ntorque_gain_error = 0.0500173 ",
    "\nseed = 1 ": "\nseed = 57721566 ",
}
PLANT = {float(new.split("=")[1]) for new in CHANGES.values()}
MOTION = ("incident", "measure", "identify")  # they need one; the last two measure it
READS = [each.name for each in VERBS if each.effect is Effect.reads and each.tier is Tier.observe]
ARGS: dict[str, dict[str, Any]] = {
    "status": {"brief": False},
    "document": {"name": "swaps"},
    "history": {"seconds": 0.2, "fields": ["position_rad", "torque_nm", "law_torque_nm", "probe"]},
    "law_check": {"source": (ROOT / "laws/pd.cpp").read_text(), "name": "pd.cpp"},
}


def told(value: Any) -> set[float]:
    """Numbers of the plant in it."""
    text = value if isinstance(value, str) else json.dumps(value)
    return PLANT & {float(each) for each in re.findall(r"\d+\.?\d*(?:[eE][-+]?\d+)?", text)}


@pytest.fixture(scope="module")
def gateway() -> Iterator[Gateway]:
    with calm.calm_robot(changes=CHANGES), calm.connected() as robot:
        server = Gateway(robot, token="sesame", tier=Tier.person)
        server.start()
        yield server
        server.close()


def test_no_verb_and_no_document_tells_the_plant_but_the_one_for_a_person(gateway: Gateway) -> None:
    with (
        Remote("127.0.0.1", gateway.port, lower("sesame", Tier.move)) as agent,
        Remote("127.0.0.1", gateway.port, "sesame") as person,
    ):
        source = (ROOT / "laws/gravity_pd.cpp").read_text()
        swapped = agent.call("swap", source=source, name="gravity_pd.cpp", brief=False)  # its trial simulates the plant
        agent.call("hold")  # an incident
        number = swapped["certificate"].removesuffix(".json")
        answers = {verb: agent.call(verb, **ARGS.get(verb, {})) for verb in READS if verb not in MOTION}
        answers["swap"] = swapped
        names = [each["name"] for each in answers["documents"]["documents"]]
        assert len(READS) > 15 and len(names) > 15
        for name in [*names, f"swaps/{number}", f"swaps/{number}.cpp"]:
            answers[name] = agent.call("document", name=name)["text"]
            assert answers[name] == library.read(f"lithe://{name}", lambda verb, args: agent.call(verb, **args))["text"]
        assert {name: found for name, answer in answers.items() if (found := told(answer))} == {}
        with pytest.raises(lithe.Refused) as refusal:
            agent.call("sim_truth")
        assert refusal.value.code == "no_permission"
        assert told(person.call("sim_truth")) == PLANT, "what the search above looks for"


def test_of_a_chain_only_what_a_tape_measure_tells() -> None:
    assert chain_of(ROOT / "robots/chain.toml") == {
        "names": ("shoulder", "elbow", "wrist"),
        "length_m": (0.25, 0.2, 0.12),
        "gravity_m_s2": 9.81,
    }
