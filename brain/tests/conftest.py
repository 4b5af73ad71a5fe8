# SPDX-License-Identifier: Apache-2.0
"""What the Brain's tests stand on: one real robot per test file, and a connection of its own for each test."""

import os
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import calm
import lithe
import numpy as np
import pypi
import pytest
from lithe.gateway import Gateway
from lithe.remote import Remote
from lithe.vocabulary import Tier
from system.pypi import Package
from system.robot_rig import RobotRig


@pytest.fixture(scope="module")
def rig() -> Iterator[RobotRig]:
    """A running robot."""
    with calm.calm_robot() as running:
        yield running


@pytest.fixture(scope="module")
def pin() -> Iterator[Any]:
    """Pinocchio, installed once. The numpy beside it is left alone."""
    site = Package("pin==4.1.0").folder / f"cmeel.prefix/lib/{pypi.VERSION}/site-packages"
    sys.path.append(str(site))
    import pinocchio

    yield pinocchio
    sys.path.remove(str(site))


@pytest.fixture
def robot(rig: RobotRig) -> Iterator[lithe.Robot]:
    """A connection; armed again if the test before left it otherwise. pytest itself keeps its cores."""
    cores = os.sched_getaffinity(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pytest has imported numpy long ago
        connection = lithe.connect("arm")
    os.sched_setaffinity(0, cores)
    # A disarm of the test before brakes first; nothing is latched then.
    RobotRig.wait_for(lambda: (connection.status()["mode"], connection.status()["fault"]) != ("safe_stop", "none"))
    if connection.status()["mode"] in ("estop", "safe_stop"):
        connection.reset()
    if connection.status()["mode"] != "active":
        connection.arm()
    yield connection
    connection.close()


@pytest.fixture
def gateway(robot: lithe.Robot) -> Iterator[Gateway]:
    verbs = {
        "add": lambda args: args["a"] + args["b"],
        "stumble": lambda args: args.nothing,
        "mumble": lambda args: object(),
        "sums": lambda args: {"angles": np.array([0.5, np.nan]), "n": np.int64(3), "pair": (1, 2)},
    }
    server = Gateway(robot, verbs, token="sesame", tier=Tier.person)
    server.start()
    yield server
    server.close()


@pytest.fixture
def remote(gateway: Gateway) -> Iterator[Remote]:
    client = Remote("127.0.0.1", gateway.port, "sesame")
    yield client
    client.close()
