// SPDX-License-Identifier: Apache-2.0
// Checks the certificates of a robot against the chain that binds them (record.hpp).
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "supervisor/core/answer.hpp"

namespace lithe::swap {

struct ChainProblem {
  std::string what;      // changed, missing, extra or order
  std::string file;      // of the certificate; empty: a line that names none
  std::size_t line = 0;  // of the chain; 0: none
  std::string text;      // one sentence
};

struct Chain {
  std::size_t writings = 0;
  std::size_t certificates = 0;        // that the chain names
  std::size_t cut = 0;                 // writings that a full disk or a crash cut short: no problem, but worth a look
  std::vector<ChainProblem> problems;  // empty = nothing was changed

  Json to_json() const;
};

// Reads what a RecordBook has written.
// Contract: any bytes are safe · a supervisor may write at the same time · removal of the newest lines together with
// their files is not detected
Chain verify_chain(const std::filesystem::path& dir);

}  // namespace lithe::swap
