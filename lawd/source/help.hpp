// SPDX-License-Identifier: Apache-2.0
// Adds to a compiler's message what to write instead: the fields that exist, the argument that a name belongs to, the
// missing #include.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "lawd/source/admission_tokens.hpp"

namespace lithe::lawd {

// For those who have sent no law.
inline constexpr std::string_view kWholeLaw =
    "; a whole law is: #include <lithe/law.hpp>, then struct Law { struct Params { lithe::Param kp_nm_rad{4, 0, 40}; "
    "}; struct State {}; static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { for "
    "(std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = p.kp_nm_rad * (t.setpoint_position_rad[j] - "
    "t.position_rad[j]); } }; LITHE_LAW(Law, \"law\");";

// The data fields of `struct NAME { ... };`, in order; empty when there is no such struct.
std::vector<std::string> fields_of(const Tokens& tokens, std::string_view name);

// Contract: any text is safe
class Help {
 public:
  // `source`: the law; `contract`: the text of lithe/law.hpp.
  Help(std::string_view source, std::string_view contract);

  // `message` of g++ (in English), with what helps; unchanged when nothing is known.
  std::string with_help(const std::string& message) const;

 private:
  std::string about_field(const std::string& message) const;
  std::string about_name(const std::string& message) const;
  std::vector<std::string> fields(std::string_view type) const;

  Tokens source_, contract_;
};

}  // namespace lithe::lawd
