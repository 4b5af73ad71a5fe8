// SPDX-License-Identifier: Apache-2.0
// The items of the checklist, each with its check: one function a file, in the order of their numbers.
#pragma once

#include "host/doctor/item.hpp"

namespace lithe::host {

inline constexpr bool kReboot = true, kNow = false;  // when the fix of an item is in force

std::span<const Item> scheduler_items();
std::span<const Item> realtime_items();
std::span<const Item> interrupts_items();
std::span<const Item> kernel_noise_items();
std::span<const Item> power_items();
std::span<const Item> memory_items();

}  // namespace lithe::host
