// SPDX-License-Identifier: Apache-2.0
// Looks for gaps on one core, with a thread that spins there. Needs no privileges.
#pragma once

#include "host/doctor/measure/measured.hpp"
#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

// Waits `seconds`. Uses all of the core meanwhile: never on the core of a running Spine. The error says why the core
// cannot be used.
Result<Measured> measure(const HostFiles& files, int cpu, double seconds);

}  // namespace lithe::host
