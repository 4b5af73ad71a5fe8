// SPDX-License-Identifier: Apache-2.0
// Adds to a compiler's message what to write instead: the fields that exist, the argument that a name belongs to, the
// missing #include.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "lawd/source/admission_tokens.hpp"

namespace lithe::lawd {

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
