// SPDX-License-Identifier: Apache-2.0
// Plans files below /etc that outlive a boot, each only where the system has its folder. These functions only read.
#pragma once

#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/change.hpp"
#include "spine/robot/config.hpp"

namespace lithe::host {

// Limits of locked memory and of priority, and the settings of /proc/sys for every boot.
Plan lasting_plan(const HostFiles& files);

inline constexpr const char* kSysctlItem = "sysctl";
inline constexpr const char* kUnitFolder = "/etc/systemd/system";
inline constexpr const char* kUnit = "lithe-tune.service";
inline constexpr const char* kUnitItem = "systemd_unit";
inline constexpr const char* kRulesItem = "udev_rules";

// A unit of systemd that makes the settings of the kernel for these cores again at every start. `program`: the path of
// lithe.
Plan unit_plan(const HostFiles& files, const std::string& program, const std::vector<int>& cores, bool partition);

// Rules of udev for the devices that a robot's buses name: a CAN interface keeps its name, an adapter behind a serial
// device gets a name that stays (/dev/lithe/BUS) and rights for the group dialout: by its USB device's number, or by
// the port where another device there has the same number. One that is not there is `not_done`, and keeps its rule of
// before; one that cannot be told from another is `not_done`, too, and has none.
Plan rules_plan(const HostFiles& files, const robot::RobotConfig& robot);

// Kernel settings, until the next boot, that keep other work off the robot's cores.

// The settings that differ: interrupts, workqueues, watchdogs, timers, memory scanning, frequency. `cores`: the
// robot's, ascending. A setting that this kernel does not have is left out; one that cannot be read is `not_done`, with
// the reason. Only reads.
Plan runtime_plan(const HostFiles& files, const std::vector<int>& cores);

}  // namespace lithe::host
