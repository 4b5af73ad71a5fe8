// SPDX-License-Identifier: Apache-2.0
// Refusals of the compile service.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "lawd/core/admission.hpp"

namespace lithe::lawd {

nlohmann::json refuse(const std::string& stage, const std::string& text,
                      nlohmann::json diagnostics = nlohmann::json::array());

// A refusal about the law as a whole, not one line.
nlohmann::json refuse_whole(const std::string& stage, const std::string& name, const std::string& reason);

// The same about one line of `source`; 0 = none.
nlohmann::json refuse_at(const std::string& stage, const std::string& name, const std::string& source, int line,
                         const std::string& reason);

// An object that could not be examined is refused too; this is not the law's fault and is not cached.
nlohmann::json refuse_admission(const Admission& admission, const std::string& name, const std::string& source);

// A step got too little processor time (child.hpp: starved_text()). This is no evidence against the law.
nlohmann::json refuse_starved(const std::string& text);

// The message of a program that exceeded a limit.
bool disk_is_full(const std::string& text);
bool memory_is_full(const std::string& text);

}  // namespace lithe::lawd
