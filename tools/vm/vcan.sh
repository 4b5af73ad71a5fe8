# SPDX-License-Identifier: Apache-2.0
# Run in the machine that tools/vm/vcan.py boots: the tests of our SocketCAN bus; then a robot whose buses are CAN
# interfaces, from `lithe sim` to the Spine. tests/system/buses/test_vcan.py holds its steps against what must be.
served() { grep -q "can2 socketcan vcan3" "$1"; }
well() { grep -q '"sent"' "$1" && ! grep -q '"problems": \[$' "$1"; }
lost() { [ "$(grep -c '"lost"[,]*$' "$1")" -ge 3 ]; }
named() { grep -q "vcan1: is down" "$1"; }
matching() { grep -q '"matches": true,$' "$1" && ! grep -q '"matches": false' "$1"; }

simulate() {
  lithe sim "$1" >/tmp/sim.log 2>&1 &
  simulation=$!
  await served cat /tmp/sim.log
}

ended() {
  kill "$1"
  wait "$1"
}

ip link add dev vcan0 type vcan && ip link set vcan0 up
export LITHE_CAN_INTERFACE=vcan0
step program hal_bus_socketcan_tests --gtest_color=no

for i in 1 2 3; do ip link add dev vcan$i type vcan; done
ip link set vcan3 mtu 16 # classic CAN only
for i in 1 2 3; do ip link set vcan$i up; done

step sim-less simulate /less.toml
step scan-less lithe --json bus scan /robot.toml
step sim-less-ends ended $simulation

step sim simulate /robot.toml
step scan await matching lithe --json bus scan /robot.toml
step scan-wrong lithe --json bus scan /wrong.toml

# Without a law: there is no compiler here.
lithe run /robot.toml --no-arm >/tmp/run.log 2>&1 &
robot=$!
step well await well lithe --json status
step monitor lithe --json bus monitor /robot.toml --count 120 --seconds 20
step scan-beside lithe --json bus scan /robot.toml
step well-still await well lithe --json status
ip link set vcan1 down
step lost await lost lithe --json status
step named await named cat /tmp/run.log
ip link set vcan1 up
step back await well lithe --json status
step stop lithe stop
step run-ends wait $robot
step run-log cat /tmp/run.log
step sim-ends ended $simulation
step sim-log cat /tmp/sim.log
