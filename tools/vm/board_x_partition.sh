# SPDX-License-Identifier: Apache-2.0
# Run on board x (tools/vm/boards.py), booted without isolcpus: a partition of cgroup v2 made by hand, what the doctor says of it,
# a robot in it.
running() { grep -q '"spine_core"' "$1"; }
group=/sys/fs/cgroup/robot
partition() {
  echo +cpuset >/sys/fs/cgroup/cgroup.subtree_control && mkdir $group &&
    echo 1 >$group/cpuset.cpus && echo isolated >$group/cpuset.cpus.partition && cat $group/cpuset.cpus.partition
}
# This shell, and all that it starts from then on.
enter() { echo $$ >$1/cgroup.procs; }

mount -t cgroup2 none /sys/fs/cgroup
step isolated cat /sys/devices/system/cpu/isolated
step doctor-before told lithe --json doctor --cpu 1
step expected-before bash /doctor_expected.sh 1
step settings settings
step partition partition
step doctor-partition told lithe --json doctor --cpu 1
step expected-partition bash /doctor_expected.sh 1
step apply told lithe --json tune apply --cores 1
step settings-tuned settings
step doctor-tuned told lithe --json doctor --cpu 1
step expected-tuned bash /doctor_expected.sh 1
step enter enter $group
lithe run /robot.toml --no-arm >/tmp/run.log 2>&1 &
robot=$!
step status await running lithe --json status
step stop lithe stop
step run-ends wait $robot
step leave enter /sys/fs/cgroup
step revert lithe --json tune revert
step settings-after settings
