// SPDX-License-Identifier: Apache-2.0
// The compiler of this machine, the contract (headers), and the precompiled contract, with and without Eigen.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "lawd/run/child.hpp"

namespace lithe::lawd {

// Where lithe/law.hpp is: $LITHE_CONTRACT_DIR, else beside the executable (../include), else the source tree.
std::string find_contract_dir();

// Why the cache cannot be used (wrong contents, or a full disk): one sentence.
std::string full_disk_text(const std::string& dir);

class Toolchain {
 public:
  // Finds g++ ($LITHE_CXX, else g++) and ld, and precompiles the contract into `cache` unless it is there already.
  // Without a precompiled header laws only compile slower. error() is set when there is no compiler.
  Toolchain(std::string contract_dir, std::string cache);

  const std::string& error() const { return error_; }
  // Fingerprint of all inputs except the source: compiler, flags, contract. SHA-256 as hex.
  const std::string& fingerprint() const { return fingerprint_; }
  // For a certificate: {"compiler", "linker", "flags", "contract"}; the flags as one line, contract = the fingerprint.
  nlohmann::json to_json() const;
  const std::string& contract_dir() const { return contract_dir_; }
  bool precompiled() const { return !law_.dir.empty(); }
  double precompile_ms() const { return precompile_ms_; }

  // Used when the compiler fails with the precompiled header.
  void precompile_again();

  // A source that includes Eigen gets lithe/eigen.hpp before it. The first one waits until that is precompiled.
  enum class Contract { precompiled, as_text };
  std::vector<std::string> compile_command(const std::string& source, const std::string& object,
                                           Contract contract = Contract::precompiled);
  std::vector<std::string> link_command(const std::string& object, const std::string& library) const;
  // Links for a slot of the arena, with the linker script `script`. With debug lines the result is only for locating
  // source lines.
  enum class Lines { none, kept };
  std::vector<std::string> place_command(const std::string& object, const std::string& script,
                                         const std::string& program, Lines lines = Lines::none) const;

 private:
  struct Header {
    std::string name;
    std::string dir{};  // with its precompiled form; empty = there is none
    bool tried = false;
  };

  void find_programs();
  void precompile(Header& header);
  std::vector<std::string> base_command() const;

  std::string contract_dir_, cache_;
  std::string compiler_;
  std::string linker_;
  std::string version_, linker_version_;
  std::string fingerprint_;
  Header law_{"lithe/law.hpp"}, eigen_{"lithe/eigen.hpp"};
  std::string error_;
  double precompile_ms_ = 0;
};

}  // namespace lithe::lawd
