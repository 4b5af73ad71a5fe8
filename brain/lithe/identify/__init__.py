# SPDX-License-Identifier: Apache-2.0
"""The parameters of a robot from its motion: of single joints (`joint`), of a chain of links (`chain`), of any tree of
links with a model file (`model`); which motion tells most (`design`). `python -m lithe.identify ROBOT.toml DATA.npy`
prints those of a recorded motion.
"""

from .chain import ChainFit, Parameter, Payload, describe, identify_chain, payload
from .design import design_multisine
from .joint import Arm, Motion, identify_arm, identify_joint, mgl_at_rest, torque_lag_s
from .model import Model, describe_model
from .regressor import Description

__all__ = [
    "Arm", "ChainFit", "Description", "Model", "Motion", "Parameter", "Payload", "describe", "describe_model",
    "design_multisine", "identify_arm", "identify_chain", "identify_joint", "mgl_at_rest", "payload", "torque_lag_s",
]  # fmt: skip
