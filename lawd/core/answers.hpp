// SPDX-License-Identifier: Apache-2.0
// The answers that say no.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "lawd/core/admission.hpp"

namespace lithe::lawd {

nlohmann::json refuse(const std::string& stage, const std::string& text,
                      nlohmann::json diagnostics = nlohmann::json::array());

// A refusal that is about the law as a whole, not about one line.
nlohmann::json refuse_whole(const std::string& stage, const std::string& name, const std::string& reason);

// What could not be looked at is refused too, but it is not the law's fault, and nobody remembers it.
nlohmann::json refuse_admission(const Admission& admission, const std::string& name, const std::string& source);

// The machine gave a step of the service no processor time (child.hpp: starved_text()). Nothing is known against the
// law.
nlohmann::json refuse_starved(const std::string& text);

// What a program says that ran into a limit.
bool disk_is_full(const std::string& text);
bool memory_is_full(const std::string& text);

}  // namespace lithe::lawd
