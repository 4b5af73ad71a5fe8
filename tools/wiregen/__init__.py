# SPDX-License-Identifier: Apache-2.0
"""The schema compiler: schema/wire.toml to a small model, one emitter per language."""
