// SPDX-License-Identifier: Apache-2.0
// The certificates a robot's swaps leave on disk: <dir>/0001.json, 0002.json ...
#pragma once

#include <filesystem>

#include "spine/core/result.hpp"
#include "supervisor/swap/answer.hpp"

namespace lithe::swap {

// Contract: one thread · a file appears complete or not at all · numbers go on where an earlier run stopped.
class RecordBook {
 public:
  explicit RecordBook(std::filesystem::path dir) : dir_(std::move(dir)) {}

  // Path of the new file. A full disk is an Error the robot survives: the caller warns and goes on.
  Result<std::filesystem::path> write(const Json& certificate);
  // Replaces what write() made there, in one step.
  Result<> rewrite(const std::filesystem::path& path, const Json& certificate);

 private:
  int next_number() const;

  std::filesystem::path dir_;
  int next_ = 0;
};

}  // namespace lithe::swap
