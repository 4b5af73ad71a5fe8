// SPDX-License-Identifier: Apache-2.0
// The certificates a robot's swaps leave on disk: <dir>/0001.json, 0002.json ... and <dir>/chain.jsonl, which binds
// them (verify_chain() checks it). Beside each is the text of its law, 0001.cpp, as it was sent, of the newest and of
// those that can still be returned to; the certificate has its hash.
//
// A certificate is rewritten until its law is unloaded (committed, measured, confirmed, rolled back, retired). Each
// rewrite adds one line to chain.jsonl:
//   {"file":"0007.json","sha256":<of the text as written>,"previous":<sha256 of the line before, without its newline>}
// and every certificate carries, as "previous", the hash of the line before its own first one. A later change of a
// certificate, a line, or their order breaks a hash.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/result.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

inline constexpr const char* kChain = "chain.jsonl";
inline constexpr std::size_t kMaxCertificateBytes = std::size_t{16} << 20;  // limit for reading one certificate

// Where the certificates of a robot are: below $LITHE_OUT_DIR, else below out/ of the working directory. Absolute.
std::filesystem::path records_of(const std::string& robot);

// Contract: one thread · a file appears complete or not at all · numbers go on where an earlier run stopped.
class CertificateFiles {
 public:
  static constexpr std::size_t kMostTexts = 256;
  static constexpr std::size_t kMostRemovals = 8;

  explicit CertificateFiles(std::filesystem::path dir, std::size_t most_texts = kMostTexts)
      : dir_(std::move(dir)), most_texts_(most_texts) {}

  struct Page {
    std::filesystem::path path;  // empty: it could not be written
    std::string previous;        // the hash its certificate carries
    int folder = 0;              // which of the folders it was written to: see begun_anew()
  };

  // Writes a new file, and the law's text beside it unless that is empty. On a full disk it returns an Error; the
  // caller warns and continues.
  Result<Page> write(const Json& certificate, const std::string& source = "");
  // Removes the texts of laws but for the newest ones and those that are `needed`, the oldest first, kMostRemovals a
  // call: it runs in the event loop, and an update may find thousands. Certificates stay, and their chain.
  void drop_old_texts(const std::set<std::filesystem::path>& needed);
  // Replaces a file of write() atomically.
  Result<> rewrite(const Page& page, const Json& certificate) { return put(page, certificate); }
  const std::filesystem::path& folder() const { return dir_; }
  // The folder was removed while we used it, and was made again with an empty chain: the first certificate in it. Empty
  // = this has not happened.
  const std::string& begun_anew() const { return begun_anew_; }

 private:
  Result<> open();
  Result<> find_end();
  void notice_removal();
  Result<> put(const Page& page, Json certificate);
  Result<> add_line(const Page& page, const std::string& text);

  std::filesystem::path dir_;
  std::size_t most_texts_;
  std::set<int> texts_;       // numbers of certificates with the text of their law
  int next_ = 0;              // 0 = not opened yet
  int used_ = 0;              // the last number given
  std::string last_line_;     // hash of the last line of the chain; empty = there is none
  bool line_is_cut_ = false;  // its newline is missing: full disk, or a crash
  int folders_ = 0;           // number of times the folder was made again
  std::string begun_anew_;
};

// The text of each law that ran, by its name.
// Contract: one thread · the newest of a name, of kMost names; the one that ran first goes when there are more.
class LawTexts {
 public:
  static constexpr std::size_t kMost = 256;

  void add(const std::string& law, const std::filesystem::path& text);
  // Empty: none is known.
  std::filesystem::path find(const std::string& law) const;
  const std::deque<std::pair<std::string, std::filesystem::path>>& all() const { return texts_; }

 private:
  std::deque<std::pair<std::string, std::filesystem::path>> texts_;  // the newest last
};

// Certificates that could not be written: they wait until the disk has room, without the texts of their laws.
// Contract: one thread · holds kMost certificates; the oldest goes when there are more.
class LateCertificates {
 public:
  static constexpr std::size_t kMost = 256;
  static constexpr std::int64_t kPauseNs = 1'000'000'000;  // between two tries

  // Stores the newest version of a certificate that could not be written; `page`: its file, when it has one already.
  void hold(std::uint64_t request_id, Json certificate, const CertificateFiles::Page& page = {});
  // Its newest version is on disk.
  void forget(std::uint64_t request_id) { late_.erase(request_id); }
  // Writes waiting certificates until one fails again; most calls do nothing.
  void retry(CertificateFiles& book, std::int64_t now_ns);
  std::size_t waiting() const;

 private:
  struct Late {
    Json certificate;  // null = it has been written
    CertificateFiles::Page page;
  };
  std::map<std::uint64_t, Late> late_;
  std::int64_t next_try_ns_ = 0;
};

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

// Reads what a CertificateFiles has written.
// Contract: any bytes are safe · a supervisor may write at the same time · removal of the newest lines together with
// their files is not detected
Chain verify_chain(const std::filesystem::path& dir);

}  // namespace lithe::control
