# SPDX-License-Identifier: Apache-2.0
# Run in a machine of four cores that was booted with isolcpus=1-3: a robot whose file names no core, one whose file
# names core 2, one that asks for a core that is not there; then one in an isolated partition of cgroup v2.
# tests/system/host/test_isolated_cores.py reads the steps.
running() { grep -q '"spine_core"' "$1"; }
threads() { grep Cpus_allowed_list /proc/$(sed -n 's/^ *"spine_pid": \([0-9]*\).*/\1/p' /tmp/answer)/task/*/status; }
start() {
  lithe run "$1" --no-arm >/tmp/run.log 2>&1 &
  robot=$!
}
# This shell, and all that it starts from then on, in a partition of cores 2 and 3.
partition() {
  group=/sys/fs/cgroup/robot
  mount -t cgroup2 none /sys/fs/cgroup && echo +cpuset >/sys/fs/cgroup/cgroup.subtree_control && mkdir $group &&
    echo 2-3 >$group/cpuset.cpus && echo isolated >$group/cpuset.cpus.partition && echo $$ >$group/cgroup.procs &&
    cat $group/cpuset.cpus.partition
}

step benches bench_cores
step isolated cat /sys/devices/system/cpu/isolated
step affinity grep Cpus_allowed_list /proc/self/status
start /robot.toml
step status await running lithe --json status
step threads threads
step words lithe status
step stop lithe stop
step run-ends wait $robot
step run-log cat /tmp/run.log
start /named.toml
step named await running lithe --json status
step named-threads threads
step named-stop lithe stop
step named-ends wait $robot
step absent lithe run /absent.toml --no-arm
step partition partition
start /robot.toml
step inside await running lithe --json status
step inside-words lithe status
step inside-stop lithe stop
step inside-ends wait $robot
