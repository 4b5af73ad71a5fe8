// SPDX-License-Identifier: Apache-2.0
// The certificates a robot's swaps leave on disk: <dir>/0001.json, 0002.json ... and <dir>/chain.jsonl, which binds
// them.
//
// A certificate goes on changing while its law lives (committed, measured, confirmed, rolled back, retired), so what is
// chained is not files but writings. Each writing adds a line to chain.jsonl:
//   {"file":"0007.json","sha256":<of the text as written>,"previous":<sha256 of the line before, without its newline>}
// and every certificate carries, as "previous", the hash of the line before its own first one. Who changes a
// certificate, a line, or their order later, breaks a hash (verify_chain). What was cut off at the end is not noticed.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "supervisor/swap/answer.hpp"

namespace lithe::swap {

// Contract: one thread · a file appears complete or not at all · numbers go on where an earlier run stopped.
class RecordBook {
 public:
  explicit RecordBook(std::filesystem::path dir) : dir_(std::move(dir)) {}

  struct Page {
    std::filesystem::path path;  // empty: it could not be written
    std::string previous;        // the hash its certificate carries
  };

  // A new file. A full disk is an Error the robot survives: the caller warns and goes on.
  Result<Page> write(const Json& certificate);
  // Replaces what write() made there, in one step.
  Result<> rewrite(const Page& page, const Json& certificate) { return put(page, certificate); }

 private:
  Result<> open();
  void find_end();
  Result<> put(const Page& page, Json certificate);
  Result<> add_line(const Page& page, const std::string& text);

  std::filesystem::path dir_;
  int next_ = 0;              // 0 = not opened yet
  std::string last_line_;     // hash of the last line of the chain; empty = there is none
  bool line_is_cut_ = false;  // its newline is missing: the disk was full, or the machine went down
};

struct Chain {
  std::size_t writings = 0;
  std::size_t certificates = 0;
  std::size_t cut = 0;                // writings that a full disk or a crash cut short: no problem, but worth a look
  std::vector<std::string> problems;  // one sentence each, with file or line; empty = nothing was changed
};

// Reads what a RecordBook has written. Contract: any bytes are safe.
Chain verify_chain(const std::filesystem::path& dir);

}  // namespace lithe::swap
