# SPDX-License-Identifier: Apache-2.0
# Run by /init of the machine that tools/vcan.py boots, after the program of its own: a robot whose buses are CAN
# interfaces, from `lithe sim` to the Spine. Each step prints `vcan: begin NAME`, what it says, `vcan: end NAME CODE`;
# tests/system/test_vcan.py holds them against what must be.
step() {
  name=$1
  shift
  echo "vcan: begin $name"
  "$@" 2>&1
  echo "vcan: end $name $?"
}

# Until a command's output has the words. What does not come in a minute does not come: the rest would wait in vain, too.
await() {
  words=$1
  shift
  [ -e /tmp/vain ] && return 1
  for _ in $(seq 120); do
    "$@" 2>&1 | grep -q "$words" && return 0
    sleep 0.5
  done
  echo "waited in vain for '$words' of: $*"
  "$@" 2>&1
  touch /tmp/vain
  return 1
}

simulate() {
  lithe sim "$1" >/tmp/sim.log 2>&1 &
  simulation=$!
  await "can2 socketcan vcan3" cat /tmp/sim.log
}

ended() {
  kill "$1" 2>/dev/null
  wait "$1"
}

# No joint has a problem, and all are there.
all_well() {
  lithe --json status >/tmp/status && ! grep -A 1 '"problems": \[$' /tmp/status && grep -q '"sent"' /tmp/status && echo well
}

for i in 1 2 3; do ip link add dev vcan$i type vcan; done
ip link set vcan3 mtu 16
for i in 1 2 3; do ip link set vcan$i up; done

step sim-less simulate /less.toml
step scan-less lithe --json bus scan /robot.toml
step sim-less-ends ended $simulation
step sim simulate /robot.toml
step scan lithe --json bus scan /robot.toml
step scan-words lithe bus scan /robot.toml
step scan-wrong lithe --json bus scan /wrong.toml
lithe run /robot.toml --no-arm >/tmp/run.log 2>&1 &
robot=$!
step robot-runs await "frankenstein" lithe status
step all-well await well all_well
step status-before lithe --json status
step monitor lithe --json bus monitor /robot.toml --count 60 --seconds 20
step status-after lithe --json status
ip link set vcan1 down
step lost await '"lost"' lithe --json status
step status-lost lithe --json status
ip link set vcan1 up
step back await well all_well
step status-back lithe --json status
step stop lithe stop
step run-ends ended $robot
step sim-ends ended $simulation
step run-log cat /tmp/run.log
step sim-log cat /tmp/sim.log
