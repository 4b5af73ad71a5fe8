// SPDX-License-Identifier: Apache-2.0
// The compile service: source text in, an object that has run a dry thousand steps out.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "lawd/run/child.hpp"
#include "lawd/object/place.hpp"
#include "lawd/compile/toolchain.hpp"

namespace lithe::lawd {

// Contract: one thread · never throws for bad input: every answer is JSON with "ok".
class Service {
 public:
  // `arena_fd`: the code arena, as the supervisor hands it over; -1 or no arena = laws cannot be placed.
  // `compiler`: what one run of the compiler may take.
  explicit Service(std::string cache, int arena_fd = -1, const Limits& compiler = kCompilerLimits);

  // Five decompositions of 12 x 12 need 700 MiB.
  static constexpr Limits kCompilerLimits{.memory_bytes = std::size_t{1} << 30};

  // One request line, one answer. `quit` is set by the verb quit.
  nlohmann::json answer(const std::string& line, bool& quit);

 private:
  struct Job {
    std::string source, name, hash;
    std::uint32_t joints;
    bool admit = true;    // false only in tests of what must hold without admission
    bool dry_run = true;  // likewise
  };
  nlohmann::json compile(const nlohmann::json& request);
  nlohmann::json place(const nlohmann::json& request);
  nlohmann::json locate(const nlohmann::json& request) const;
  nlohmann::json build(const Job& job);
  nlohmann::json run_compiler(const Job& job, const std::string& file, const std::string& object,
                              std::string& warnings);
  nlohmann::json from_cache(const Job& job) const;
  nlohmann::json try_and_store(const Job& job, const std::string& object, const std::string& library,
                               const std::string& warnings, const nlohmann::json& gates);

  std::string cache_;
  Limits compiler_;
  Toolchain toolchain_;
  Placer placer_;
};

}  // namespace lithe::lawd
