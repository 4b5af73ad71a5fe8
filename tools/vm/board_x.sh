# SPDX-License-Identifier: Apache-2.0
# Run on board x (tools/vm/boards.py), which was booted with the line that `lithe tune apply` wrote into the files below
# /etc: what is in force, a robot, and then everything given back.
running() { grep -q '"spine_core"' "$1"; }
threads() { grep Cpus_allowed_list /proc/$(sed -n 's/^ *"spine_pid": \([0-9]*\).*/\1/p' /tmp/answer)/task/*/status; }

mount -t cgroup2 none /sys/fs/cgroup
step cmdline cat /proc/cmdline
step isolated cat /sys/devices/system/cpu/isolated
step tickless cat /sys/devices/system/cpu/nohz_full
# A kernel calibrates its counter for some seconds after the boot.
for _ in 1 2 3 4 5 6 7 8 9 10; do grep -q early /sys/devices/system/clocksource/clocksource0/current_clocksource && sleep 1; done
step doctor told lithe --json doctor
step expected bash /doctor_expected.sh 1

lithe run /robot.toml --no-arm >/tmp/run.log 2>&1 &
robot=$!
step status await running lithe --json status
step threads threads
step doctor-beside told lithe --json doctor
step stop lithe stop
step run-ends wait $robot

step plan lithe --json tune plan --cores 1,3
step settings settings
step apply told lithe --json tune apply --cores 1,3
step settings-tuned settings
step revert lithe --json tune revert
step settings-after settings
step files-after find /etc/default /etc/sysctl.d /etc/security /boot -type f -exec md5sum {} +
