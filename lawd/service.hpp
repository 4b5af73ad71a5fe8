// SPDX-License-Identifier: Apache-2.0
// The compile service: takes source text, returns an admitted object that has passed the dry run of 1000 steps, and
// writes it into a slot of the arena.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lawd/compile/toolchain.hpp"
#include "lawd/object/link.hpp"
#include "lawd/run/child.hpp"
#include "spine/arena/arena.hpp"

namespace lithe::lawd {

// Contract: one thread · never throws for bad input: every answer is JSON with "ok".
class Service {
 public:
  // `arena_fd`: the code arena, from the supervisor, closed here after mapping, so that no child inherits it; -1 = laws
  // cannot be placed. `compiler`: limits of one compiler run.
  explicit Service(std::string cache, int arena_fd = -1, const Limits& compiler = kCompilerLimits);

  // A law with five Eigen decompositions of 12 x 12 needs 700 MiB to compile.
  static constexpr Limits kCompilerLimits{.memory_bytes = std::size_t{1} << 30};

  // One request line, one answer.
  nlohmann::json answer(const std::string& line);

 private:
  struct Job {
    std::string source, name, hash;
    std::uint32_t joints;
    bool admit = true;    // false only in tests of the containment
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
  unsigned stores_ = 0;
  Limits compiler_;
  Toolchain toolchain_;
  std::optional<arena::Writer> arena_;
  std::string arena_error_;                            // why there is none; empty = there is
  std::vector<std::pair<std::string, Linked>> links_;  // newest last; a cache, because a link takes long
};

}  // namespace lithe::lawd
