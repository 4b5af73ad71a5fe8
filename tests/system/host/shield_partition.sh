# SPDX-License-Identifier: Apache-2.0
# Run in a machine of four cores without isolcpus, as root: a command and a robot under a shield that is a partition of
# cgroup v2; then a robot whose supervisor is killed. tests/system/host/test_shield_partition.py reads the steps.
group=/sys/fs/cgroup/lithe.spine
mask() { sed -n 's/^Cpus_allowed_list:\t//p' /proc/$1/status; }
masks() { echo "$(mask $on_0) $(mask $on_1) $(mask $anywhere)"; }
running() { grep -q '"spine_core"' "$1"; }
spine_pid() { sed -n 's/^ *"spine_pid": \([0-9]*\).*/\1/p' /tmp/answer; }
threads() { grep -h Cpus_allowed_list /proc/$(spine_pid)/task/*/status; }
state() { cat $group/cpuset.cpus.partition; }
gone() { [ ! -e $group ] && cat /sys/fs/cgroup/cgroup.subtree_control; }
doctor() { lithe --json doctor --cpu 1 || [ $? = 1 ]; }
start() {
  lithe run /robot.toml --no-arm --shield >/tmp/run.log 2>&1 &
  robot=$!
}

step mount mount -t cgroup2 none /sys/fs/cgroup
taskset -c 0 sleep 1000 &
on_0=$!
taskset -c 1 sleep 1000 &
on_1=$!
sleep 1000 &
anywhere=$!
sleep 1
step masks masks
cat >/tmp/inside.sh <<END
cat /proc/self/cgroup
grep Cpus_allowed_list /proc/self/status
cat $group/cpuset.cpus.partition
{ echo -cpuset >/sys/fs/cgroup/cgroup.subtree_control; } 2>/dev/null
cat $group/cpuset.cpus.partition
for pid in $on_0 $on_1 $anywhere; do
  sed -n 's/^Cpus_allowed_list:\t//p' /proc/\$pid/status
done
END
step command lithe tune shield --partition --cores 1 -- sh /tmp/inside.sh
step command-gone gone
step command-masks masks
start
step status await running lithe --json status
step threads threads
step state state
step taken taskset -c 1 true
step doctor doctor
step stop lithe stop
step run-ends wait $robot
step run-log cat /tmp/run.log
step run-gone gone
step run-masks masks
start
step second await running lithe --json status
spine=$(spine_pid)
kill -9 $robot
step left state
kill -9 $spine
sleep 1
step revert lithe tune revert
step revert-gone gone
step revert-masks masks
lithe tune shield --cores 1 -- sh -c 'echo $$ >/tmp/command; exec sleep 1000' &
shield=$!
has_command() { grep -q '^State:.[SRD]' /proc/$(cat /tmp/command)/status; }
has_none() { ! has_command; }
step orphan-starts await has_command true
kill -9 $shield
step orphan-ends await has_none true
step orphan-revert lithe tune revert
