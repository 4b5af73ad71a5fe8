// SPDX-License-Identifier: Apache-2.0
// The status as text for a terminal: alarms first, joints in a table.
#pragma once

#include <string>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

struct Look {
  bool color = false;
  bool radians = false;  // angles in rad instead of degrees
};

// Colour only on a terminal that supports it, and not when NO_COLOR is set.
bool wants_color();

// Whole lines.
// Contract: pure · any JSON object is safe: a missing field is left out or shown as a dash
std::string status_text(const control::Json& status, const Look& look);

}  // namespace lithe::cli
