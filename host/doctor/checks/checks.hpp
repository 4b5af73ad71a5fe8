// SPDX-License-Identifier: Apache-2.0
// The checks of the checklist, one function an item. What each means is in host/doctor/table.cpp.
#pragma once

#include "host/doctor/item.hpp"

namespace lithe::host {

// scheduler.cpp
Finding check_domain_isolation(const Subject& subject);
Finding check_isolated_partition(const Subject& subject);
Finding check_v1_shield(const Subject& subject);
Finding check_user_tasks(const Subject& subject);
Finding check_kernel_threads(const Subject& subject);
Finding check_bound_kernel_threads(const Subject& subject);
Finding check_workqueues(const Subject& subject);
// realtime.cpp
Finding check_spine_pinned(const Subject& subject);
Finding check_rt_throttling(const Subject& subject);
Finding check_fair_server(const Subject& subject);
Finding check_smt(const Subject& subject);
// interrupts.cpp
Finding check_irq_affinity(const Subject& subject);
Finding check_irqbalance(const Subject& subject);
Finding check_tickless(const Subject& subject);
Finding check_rcu_callbacks(const Subject& subject);
Finding check_release_phase(const Subject& subject);
Finding check_timer_migration(const Subject& subject);
Finding check_skew_tick(const Subject& subject);
// kernel_noise.cpp
Finding check_watchdogs(const Subject& subject);
Finding check_vmstat(const Subject& subject);
Finding check_periodic_work(const Subject& subject);
Finding check_core_interrupts(const Subject& subject);
Finding check_tracing(const Subject& subject);
Finding check_clocksource(const Subject& subject);
// power.cpp
Finding check_governor(const Subject& subject);
Finding check_turbo(const Subject& subject);
Finding check_idle_states(const Subject& subject);
Finding check_bus_power(const Subject& subject);
Finding check_jetson_mode(const Subject& subject);
// memory.cpp
Finding check_memory_lock(const Subject& subject);
Finding check_malloc(const Subject& subject);
Finding check_memory_scans(const Subject& subject);
Finding check_swap(const Subject& subject);
Finding check_shared_memory(const Subject& subject);
Finding check_cache_partition(const Subject& subject);
Finding check_memory_limit(const Subject& subject);
Finding check_mitigations(const Subject& subject);

}  // namespace lithe::host
