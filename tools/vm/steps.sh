# SPDX-License-Identifier: Apache-2.0
# The words of a script that runs in the machine of tools/vm/vcan.py. Each step prints `vcan: begin NAME`, what it says,
# `vcan: end NAME CODE`.
step() {
  name=$1
  shift
  echo "vcan: begin $name"
  "$@" 2>&1
  echo "vcan: end $name $?"
}

# Until a command's answer passes the test. What does not come in a minute does not come: the rest would wait in vain.
await() {
  passes=$1
  shift
  [ -e /tmp/vain ] && return 1
  for _ in $(seq 120); do
    "$@" >/tmp/answer 2>&1
    $passes /tmp/answer && cat /tmp/answer && return 0
    sleep 0.5
  done
  echo "waited in vain; the last answer:"
  cat /tmp/answer
  touch /tmp/vain
  return 1
}
