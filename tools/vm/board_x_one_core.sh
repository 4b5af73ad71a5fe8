# SPDX-License-Identifier: Apache-2.0
# Run on board x (tools/vm/boards.py), booted with one core: what the doctor says; a plan and a shield, which cannot be; a
# robot that shares the core.
running() { grep -q '"spine_core"' "$1"; }

mount -t cgroup2 none /sys/fs/cgroup
step online cat /sys/devices/system/cpu/online
step doctor told lithe --json doctor
step expected bash /doctor_expected.sh 0
step settings settings
step refused-plan lithe --json tune plan
step refused-shield lithe run /robot.toml --shield --no-arm
lithe run /robot.toml --no-arm >/tmp/run.log 2>&1 &
robot=$!
step status await running lithe --json status
step stop lithe stop
step run-ends wait $robot
step run-log cat /tmp/run.log
step settings-after settings
