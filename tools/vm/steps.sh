# SPDX-License-Identifier: Apache-2.0
# The words of a script that runs in a machine of tools/vm/machine.py. Each step prints `vm: begin NAME`, what it says,
# `vm: end NAME CODE`.
step() {
  name=$1
  shift
  echo "vm: begin $name"
  "$@" 2>&1
  echo "vm: end $name $?"
}

# A command that ends with 1 when something is not as it could be: what that is, the reader of its document asks.
told() {
  "$@"
  [ $? -le 1 ]
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

# What `lithe tune apply` may change until the next boot, one line for each with its value.
settings() {
  for file in $(find /proc/irq /sys/devices/virtual/workqueue /sys/kernel/mm -name '*smp_affinity*' -o -name cpumask \
    -o -name enabled -o -name run | sort) /proc/sys/vm/stat_interval /proc/sys/kernel/timer_migration \
    /proc/sys/kernel/numa_balancing /proc/sys/kernel/nmi_watchdog /proc/sys/kernel/watchdog_cpumask; do
    echo "$file $(cat "$file")"
  done
}
