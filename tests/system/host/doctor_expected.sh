#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# What `lithe doctor` must say about core $1 of this machine, read a second time with nothing but the shell: one line
# "ID STATE" for each item. A file that cannot be read is unknown. For a machine on which no Spine runs.
cpu=$1
cpus=/sys/devices/system/cpu

say() { echo "$1 $2"; }
get() { cat "$1" 2>/dev/null; }
# Whether the list $1 ("0,2-3") has core $2.
lists() {
  local part first last
  for part in ${1//,/ }; do
    first=${part%-*} last=${part#*-}
    [[ $first =~ ^[0-9]+$ && $last =~ ^[0-9]+$ ]] && ((first <= $2 && $2 <= last)) && return 0
  done
  return 1
}
# Whether the mask $1 (hexadecimal, 32 cores a group) has core $2.
masks() {
  local groups group
  IFS=, read -ra groups <<<"$1"
  group=${groups[${#groups[@]} - 1 - $2 / 32]:-0}
  (((16#$group >> ($2 % 32)) & 1))
}
# "ok" if the number in file $2 is one of the others, else "warn"; unknown without a number.
is_one() {
  local value wanted
  value=$(get "$2")
  [[ $value =~ ^-?[0-9]+$ ]] || { echo unknown; return; }
  for wanted in "${@:3}"; do [[ $value == "$wanted" ]] && { echo ok; return; }; done
  echo warn
}
# The worst of these states.
worst() {
  local state
  for state in fail warn unknown ok not_applicable; do
    [[ " $* " == *" $state "* ]] && { echo $state; return; }
  done
}

# A thread for RCU callbacks may be parked: the kernel must have been told to use it.
named=$(tr ' ' '\n' </proc/cmdline | sed -n 's/^rcu_nocbs=//p') offloaded=no
{ lists "$named" "$cpu" || lists "$(get $cpus/nohz_full)" "$cpu"; } && offloaded=yes

# Tasks: PF_KTHREAD is 0x200000, PF_NO_SETAFFINITY 0x4000000.
user=ok kernel=ok balance=ok rcu=warn whole=no
grep -qs kthreadd /proc/2/comm && [[ -r /proc/1/status ]] && whole=yes
for task in /proc/[0-9]*/task/[0-9]*; do
  stat=$(get "$task/stat") list=$(sed -n 's/^Cpus_allowed_list:\t//p' "$task/status" 2>/dev/null)
  [[ -n $stat && -n $list && $task != /proc/$$/* ]] || continue
  name=${stat#*(} name=${name%)*}
  read -ra fields <<<"${stat##*) }"
  flags=${fields[6]}
  [[ $name == irqbalance ]] && balance=warn
  ((flags & 0x200000)) && [[ $name == rcuo*/$cpu && $offloaded == yes ]] && rcu=ok
  ((flags & 0x4000000)) && continue
  lists "$list" "$cpu" || continue
  if ((flags & 0x200000)); then kernel=warn; else user=fail; fi
done
if [[ $whole == no ]]; then
  [[ $user == ok ]] && user=unknown
  [[ $kernel == ok ]] && kernel=unknown
  [[ $balance == ok ]] && balance=unknown
  [[ $rcu == warn ]] && rcu=unknown
fi

# 1-7
boot=no partition=no invalid=no parts=""
lists "$(get $cpus/isolated)" "$cpu" && boot=yes
while read -r file; do
  folder=${file%/*} kind=$(get "$file")
  [[ $kind == isolated ]] && parts+=",$(get "$folder/cpuset.cpus.effective")"
  [[ $kind == isolated ]] && lists "$(get "$folder/cpuset.cpus.effective")" "$cpu" && partition=yes
  [[ $kind == *invalid* ]] && lists "$(get "$folder/cpuset.cpus")" "$cpu" && invalid=yes
done < <(find /sys/fs/cgroup -name cpuset.cpus.partition 2>/dev/null)
# Cores in no isolated partition and not isolated at boot.
left=0
for each in "$cpus"/cpu[0-9]*; do
  number=${each##*/cpu}
  lists "$(get $cpus/online)" "$number" && ! lists "$(get $cpus/isolated)" "$number" && ! lists "$parts" "$number" &&
    left=$((left + 1))
done
domains=$(sed -n "/^cpu$cpu /,/^cpu[^$cpu]/p" /proc/schedstat 2>/dev/null)
v1_root=/sys/fs/cgroup/cpuset
v1_free=no
if [[ $(get $v1_root/cpuset.sched_load_balance) == 0 ]]; then
  v1_free=yes
  for group in "$v1_root"/*/; do
    [[ $(get "$group/cpuset.sched_load_balance") != 0 ]] && lists "$(get "$group/cpuset.cpus")" "$cpu" && v1_free=no
  done
fi
if [[ $boot == yes || $partition == yes ]]; then
  say domain_isolation ok
elif [[ -z $domains || $domains == *domain* ]]; then
  say domain_isolation fail
elif grep -qs ^domain /proc/schedstat || [[ $left -gt 1 && $v1_free == yes ]]; then
  say domain_isolation ok
elif [[ $left -gt 1 ]]; then
  say domain_isolation unknown
else
  say domain_isolation fail
fi
v1=no
grep -q :cpuset: /proc/self/cgroup && v1=yes
if [[ $invalid == yes ]]; then
  say isolated_partition fail
elif [[ $partition == yes ]]; then
  say isolated_partition ok
elif [[ $v1 == yes || $boot == yes ]]; then
  say isolated_partition not_applicable
else
  say isolated_partition warn
fi
if [[ $v1 == no || $boot == yes ]]; then
  say v1_shield not_applicable
elif [[ $(get /sys/fs/cgroup/cpuset/cpuset.sched_load_balance) == 1 ]]; then
  say v1_shield warn
elif [[ -z $(get /sys/fs/cgroup/cpuset/cpuset.sched_load_balance) ]]; then
  say v1_shield unknown
elif [[ $user == fail || $kernel == warn ]]; then
  say v1_shield fail
else
  say v1_shield $user
fi
say user_tasks $user
say kernel_threads $kernel
say bound_kernel_threads unknown
mask=$(get /sys/devices/virtual/workqueue/cpumask)
if [[ -z $mask ]]; then queues=unknown; elif masks "$mask" "$cpu"; then queues=warn; else queues=ok; fi
say workqueues $queues

# 8-11
if [[ $whole == yes ]]; then say spine_pinned not_applicable; else say spine_pinned unknown; fi
case $(get /proc/sys/kernel/sched_rt_runtime_us) in
  -1) say rt_throttling ok ;;
  "") say rt_throttling unknown ;;
  *) if [[ $whole == yes ]]; then say rt_throttling not_applicable; else say rt_throttling unknown; fi ;;
esac
IFS=. read -r major minor _ <<<"$(uname -r)"
minor=${minor%%[!0-9]*}
since_612=no
((major > 6 || (major == 6 && minor >= 12))) && since_612=yes
if [[ $since_612 == no ]]; then
  say fair_server not_applicable
elif [[ $whole == no ]]; then
  say fair_server unknown
elif [[ $(get "/sys/kernel/debug/sched/fair_server/cpu$cpu/runtime") == 0 ]]; then
  say fair_server ok
else
  say fair_server not_applicable
fi
siblings=$(get "$cpus/cpu$cpu/topology/thread_siblings_list")
case $siblings in
  "$cpu") say smt ok ;;
  "") say smt unknown ;;
  *) say smt warn ;;
esac

# 12-18
irq=ok
while read -r number; do
  file=/proc/irq/$number/effective_affinity_list
  list=$(get "$file")
  [[ -n $list ]] || { [[ $irq == fail ]] || irq=unknown; list=$(get "/proc/irq/$number/smp_affinity_list"); }
  lists "$list" "$cpu" && irq=fail
done < <(grep -vE 'arch_timer|arm-pmu' /proc/interrupts | sed -n 's/^ *\([0-9]*\):.*/\1/p')
if [[ $irq == ok ]] && masks "$(get /proc/irq/default_smp_affinity)" "$cpu"; then irq=warn; fi
say irq_affinity $irq
say irqbalance $balance
tickless=no
lists "$(get $cpus/nohz_full)" "$cpu" && tickless=yes
if [[ $tickless == no ]]; then
  say tickless warn
elif [[ $since_612 == yes ]]; then
  say tickless unknown
elif ! grep -qsE '^(tsc|arch_sys_counter)$' /sys/devices/system/clocksource/clocksource0/current_clocksource; then
  say tickless unknown
else
  say tickless ok
fi
say rcu_callbacks $rcu
say release_phase unknown
timers=$(is_one - /proc/sys/kernel/timer_migration 0)
[[ $timers != ok && $tickless == yes ]] && timers=not_applicable
say timer_migration "$timers"
if grep -qw skew_tick=1 /proc/cmdline; then say skew_tick ok; else say skew_tick warn; fi

# 19-24
watchdog=$(get /proc/sys/kernel/watchdog) cores=$(get /proc/sys/kernel/watchdog_cpumask)
if [[ $watchdog == 0 ]]; then
  say watchdogs ok
elif [[ -n $cores ]] && ! lists "$cores" "$cpu"; then
  say watchdogs ok
elif [[ -z $watchdog || -z $cores ]]; then
  say watchdogs unknown
else
  say watchdogs warn
fi
interval=$(get /proc/sys/vm/stat_interval)
if [[ -z $interval ]]; then say vmstat unknown; elif ((interval >= 10)); then say vmstat ok; else say vmstat warn; fi
back=$(get /proc/sys/vm/dirty_writeback_centisecs)
if [[ $queues == ok ]] || { [[ -n $back ]] && ((back == 0 || back >= 1500)); }; then
  back=ok
elif [[ -z $back || $queues == unknown ]]; then
  back=unknown
else
  back=warn
fi
checks=not_applicable
[[ -d /sys/devices/system/machinecheck ]] &&
  checks=$(is_one - "/sys/devices/system/machinecheck/machinecheck$cpu/check_interval" 0)
say periodic_work "$(worst $back $checks)"
say core_interrupts unknown
tracer=$(get /sys/kernel/tracing/current_tracer)
if [[ -n $tracer && $tracer != nop ]] || [[ -n $(get /sys/kernel/tracing/set_event) ]] ||
  [[ -n $(cat /sys/kernel/tracing/instances/*/set_event 2>/dev/null) ]] ||
  cat /sys/kernel/tracing/instances/*/current_tracer 2>/dev/null | grep -qvx nop; then
  say tracing warn
elif [[ $tracer == nop ]] && cat /sys/kernel/tracing/set_event >/dev/null 2>&1; then
  say tracing ok
else
  say tracing unknown
fi
case $(get /sys/devices/system/clocksource/clocksource0/current_clocksource) in
  tsc | arch_sys_counter) say clocksource ok ;;
  "") say clocksource unknown ;;
  hpet | acpi_pm | jiffies | refined-jiffies) say clocksource fail ;;
  *) say clocksource warn ;;
esac

# 25-29
model=$(tr -d '\0' 2>/dev/null </proc/device-tree/model)
x86=no
grep -q ^vendor_id /proc/cpuinfo && x86=yes
frequency=$cpus/cpu$cpu/cpufreq
no_frequency=no
[[ ! -d $frequency && -z $(ls $cpus/cpufreq 2>/dev/null) ]] && no_frequency=yes
if [[ $no_frequency == yes ]]; then
  say governor not_applicable
else
  governor=$(get "$frequency/scaling_governor") driver=$(get "$frequency/scaling_driver")
  state=warn
  [[ -z $governor ]] && state=unknown
  [[ $governor == performance ]] && state=ok
  range=ok
  if [[ $driver == intel_pstate* || $driver == amd?pstate* ]]; then
    range=warn
    [[ $(get "$frequency/scaling_min_freq") == "$(get "$frequency/scaling_max_freq")" ]] && range=ok
  fi
  [[ -z $driver ]] && range=unknown
  supply=not_applicable
  [[ $x86 == no && -z $model ]] && supply=unknown
  [[ $model == *"Raspberry Pi"* ]] &&
    supply=$(is_one - "$(dirname "$(grep -ls rpi_volt /sys/class/hwmon/*/name)")/in0_lcrit_alarm" 0)
  say governor "$(worst $state $range "$supply")"
fi
if [[ $(get $cpus/intel_pstate/no_turbo) == 0 || $(get $cpus/cpufreq/boost) == 1 ]]; then
  say turbo warn
elif [[ $(get $cpus/intel_pstate/no_turbo) == 1 || $(get $cpus/cpufreq/boost) == 0 ]]; then
  say turbo ok
elif [[ $no_frequency == yes || $model == *"Raspberry Pi"* || $model == *Jetson* ]]; then
  say turbo not_applicable
else
  say turbo unknown
fi
idle=unknown
[[ -d $cpus/cpu$cpu/cpuidle/state0 ]] && idle=ok
for state in "$cpus/cpu$cpu/cpuidle"/state*; do
  [[ -d $state ]] && (($(get "$state/latency") > 2)) && [[ $(get "$state/disable") == 0 ]] && idle=warn
done
[[ $(get $cpus/cpuidle/current_driver) == none ]] && idle=not_applicable
say idle_states $idle
pcie=not_applicable usb=not_applicable
if [[ -d /sys/module/pcie_aspm ]]; then
  case $(get /sys/module/pcie_aspm/parameters/policy) in
    *"[performance]"*) pcie=ok ;;
    *"["*) pcie=warn ;;
    *) pcie=unknown ;;
  esac
fi
if [[ -d /sys/module/usbcore ]]; then
  usb=$(is_one - /sys/module/usbcore/parameters/autosuspend -1)
fi
say bus_power "$(worst $pcie $usb)"
if [[ $x86 == yes || (-n $model && $model != *Jetson* && $model != *NVIDIA*) ]]; then
  say jetson_mode not_applicable
elif [[ -z $model ]]; then
  say jetson_mode unknown
elif [[ $(get /var/lib/nvpmodel/status) == pmode:0000 ]]; then
  say jetson_mode ok
else
  say jetson_mode "$([[ -r /var/lib/nvpmodel/status ]] && echo warn || echo unknown)"
fi

# 30-39
hard=$(ulimit -H -l) # in KiB
capable=$((16#$(sed -n 's/^CapEff:\t//p' /proc/self/status) >> 14 & 1))
read -r _ _ users </proc/self/uid_map
if [[ $whole == no ]]; then
  say memory_lock unknown
elif [[ $hard == unlimited || ($capable == 1 && $users == 4294967295) ]] || ((hard >= 512 * 1024)); then
  say memory_lock ok
else
  say memory_lock fail
fi
say malloc not_applicable
huge=not_applicable same=not_applicable numa=not_applicable
if [[ -d /sys/kernel/mm/transparent_hugepage ]]; then
  case $(get /sys/kernel/mm/transparent_hugepage/enabled) in
    *"[always]"*) huge=warn ;;
    *"["*) huge=ok ;;
    *) huge=unknown ;;
  esac
fi
[[ -d /sys/kernel/mm/ksm ]] && same=$(is_one - /sys/kernel/mm/ksm/run 0 2)
[[ -d /sys/devices/system/node && $(get /sys/devices/system/node/online) != 0 ]] &&
  numa=$(is_one - /proc/sys/kernel/numa_balancing 0)
say memory_scans "$(worst $huge "$same" "$numa" "$(is_one - /proc/sys/vm/compaction_proactiveness 0)")"
if [[ $(wc -l </proc/swaps) -le 1 ]]; then
  say swap ok
elif (($(get /proc/sys/vm/swappiness) <= 10)); then
  say swap ok
else
  say swap warn
fi
if [[ $(stat -f -c %T /dev/shm) == tmpfs ]]; then say shared_memory ok; else say shared_memory fail; fi
if [[ $x86 == no ]]; then
  if [[ $model == *"Raspberry Pi"* || $model == *Jetson* ]]; then cache=not_applicable; else cache=unknown; fi
elif ! grep -m1 ^flags /proc/cpuinfo | grep -qwE 'cat_l3|cat_l2|mba'; then
  cache=not_applicable
else
  cache=warn
  for list in /sys/fs/resctrl/*/cpus_list; do lists "$(get "$list")" "$cpu" && cache=ok; done
fi
say cache_partition $cache
limit=ok
if group=$(grep -m1 :memory: /proc/self/cgroup); then
  group=/sys/fs/cgroup/memory${group#*:memory:}
  group=${group%/}
  while [[ $group == /sys/fs/cgroup/memory* ]]; do
    bytes=$(get "$group/memory.limit_in_bytes")
    if [[ -z $bytes ]]; then
      [[ $limit == warn ]] || limit=unknown
    elif ((bytes < 1 << 60)); then
      limit=warn
    fi
    group=${group%/*}
  done
else
  group=/sys/fs/cgroup$(sed -n 's/^0:://p' /proc/self/cgroup)
  while [[ $group == /sys/fs/cgroup* ]]; do
    for file in "$group/memory.high" "$group/memory.max"; do
      [[ -e $file && $(get "$file") != max ]] && limit=warn
    done
    group=${group%/*}
  done
fi
say memory_limit $limit
say mitigations not_applicable
sampling=ok
if [[ -d /sys/kernel/mm && ! -e /sys/kernel/mm/damon ]]; then
  sampling=not_applicable
elif [[ -z $(get /sys/kernel/mm/damon/admin/kdamonds/nr_kdamonds) ]]; then
  sampling=unknown
else
  for file in /sys/kernel/mm/damon/admin/kdamonds/*/state; do
    case $(get "$file") in
      on) sampling=warn ;;
      off) ;;
      *) [[ ! -e $file || $sampling == warn ]] || sampling=unknown ;;
    esac
  done
  grep -qsx Y /sys/module/damon_{reclaim,lru_sort}/parameters/enabled && sampling=warn
fi
say page_sampling $sampling
if [[ ! -e /sys/bus/virtio ]]; then
  say memory_balloon not_applicable
elif compgen -G '/sys/bus/virtio/drivers/virtio_balloon/virtio*' >/dev/null; then
  say memory_balloon warn
else
  say memory_balloon ok
fi
