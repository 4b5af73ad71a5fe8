// SPDX-License-Identifier: Apache-2.0
#include "lawd/compile/toolchain.hpp"

#include <unistd.h>

#include <chrono>
#include <filesystem>

#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "lithe/law.hpp"
#include "spine/arena/veneers.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/sha256.hpp"

namespace lithe::lawd {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string>& flags() {
  static const std::vector<std::string> all = {"-std=c++20",
                                               "-O2",
                                               "-fPIC",
                                               "-fno-exceptions",
                                               "-fno-rtti",
                                               "-fno-gnu-unique",  // otherwise dlclose keeps the old law loaded
                                               "-fvisibility=hidden",
                                               "-fno-math-errno",
                                               "-ffp-contract=off",  // the same bits on every machine
                                               "-fno-asynchronous-unwind-tables",
                                               "-fno-threadsafe-statics",
                                               "-g1",                     // for the source line of a crash
                                               "-fcallgraph-info=su,da",  // admission bounds the stack with it
                                               "-isystem/usr/include/eigen3",
                                               "-Wall",
                                               "-Wextra",
                                               "-Wno-unused-parameter",  // a law need not use all arguments
                                               "-ftemplate-depth=200",
                                               "-fdiagnostics-format=json",
                                               "-DLITHE_NJ=" + std::to_string(kMaxJoints)};
  return all;
}

// The first line a program prints on stdout; empty when it cannot be run.
std::string ask(const std::vector<std::string>& command) {
  const std::string said = run_program(command, Limits{}, STDOUT_FILENO).output;
  return said.substr(0, said.find('\n'));
}

}  // namespace

std::string find_contract_dir() {
  if (const std::string dir = environment("LITHE_CONTRACT_DIR"); !dir.empty()) return dir;
  std::error_code failed;
  for (const fs::path& dir : {fs::path(program_dir()) / "../include", fs::path(LITHE_SOURCE_CONTRACT_DIR)})
    if (fs::exists(dir / "lithe/law.hpp", failed)) return fs::weakly_canonical(dir, failed).string();
  return LITHE_SOURCE_CONTRACT_DIR;
}

std::string full_disk_text(const std::string& dir) {
  return "the disk under the law cache " + dir + " is full: free some space, or set LITHE_CACHE_DIR to another disk";
}

Toolchain::Toolchain(std::string contract_dir, std::string cache)
    : contract_dir_(std::move(contract_dir)), cache_(std::move(cache)) {
  find_programs();
  std::string all = version_;
  for (const char* header : {"law.hpp", "describe.hpp", "reflect.hpp", "eigen.hpp"}) {
    const auto text = read_file(contract_dir_ + "/lithe/" + header);
    if (!text) {
      error_ = "cannot read the law contract " + contract_dir_ + "/lithe/" + header +
               ": set LITHE_CONTRACT_DIR to the folder that holds lithe/law.hpp";
    } else {
      all += *text;
    }
  }
  if (!error_.empty()) return;
  for (const std::string& flag : flags()) all += '\n' + flag;
  all += '\n' + std::to_string(arena::veneers_hash());  // the functions a law may call
  fingerprint_ = sha256_hex(all);
  precompile(law_);
}

void Toolchain::find_programs() {
  const std::string chosen = environment("LITHE_CXX");
  compiler_ = chosen.empty() ? "g++" : chosen;
  version_ = ask({compiler_, "--version"});
  if (version_.empty()) {
    error_ = "no compiler: cannot run " + compiler_ + "; install it (apt install g++) or set LITHE_CXX";
    return;
  }
  linker_ = ask({compiler_, "-print-prog-name=ld"});
  if (linker_.empty()) linker_ = "ld";
  linker_version_ = ask({linker_, "--version"});
}

// The folder's name is made of the fingerprint, so a precompiled header of another compiler is never used, and of the
// place of the headers: the compiler's messages name it, and it tells which lines may be quoted. Its size is stored
// beside it, to detect a file truncated by a full disk or a crash.
void Toolchain::precompile(Header& header) {
  header.tried = true;
  const std::string dir = cache_ + "/contract/" + sha256_hex(fingerprint_ + contract_dir_ + header.name).substr(0, 32);
  const std::string made_header = dir + "/" + header.name + ".gch", note = dir + "/size";
  std::error_code failed;
  const auto size = fs::file_size(made_header, failed);
  if (!failed && read_file(note) == std::to_string(size)) {
    header.dir = dir;
    return;
  }
  fs::create_directories(dir + "/lithe", failed);
  const auto start = std::chrono::steady_clock::now();
  const ScratchDir scratch(cache_ + "/laws");
  if (scratch.path().empty()) return;
  const std::string part = scratch.path() + "/header.gch";
  std::vector<std::string> command = base_command();
  command.insert(command.end(),
                 {"-I", contract_dir_, "-x", "c++-header", contract_dir_ + "/" + header.name, "-o", part});
  Limits limits;
  limits.wall_ms = 60'000;
  limits.cpu_s = 60;
  if (!run_program(command, limits).clean()) return;
  const auto made = fs::file_size(part, failed);
  if (failed) return;
  fs::rename(part, made_header, failed);
  if (failed || !write_file_whole(note, std::to_string(made)).empty()) return;
  precompile_ms_ = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  header.dir = dir;
}

void Toolchain::precompile_again() {
  std::error_code ignored;
  for (Header* header : {&law_, &eigen_}) {
    if (!header->dir.empty()) fs::remove_all(header->dir, ignored);
    *header = {header->name};
  }
  precompile(law_);
}

nlohmann::json Toolchain::to_json() const {
  std::string line;
  for (const std::string& flag : flags()) line += (line.empty() ? "" : " ") + flag;
  return {{"compiler", version_}, {"linker", linker_version_}, {"flags", line}, {"contract", fingerprint_}};
}

std::vector<std::string> Toolchain::base_command() const {
  std::vector<std::string> command = {compiler_};
  command.insert(command.end(), flags().begin(), flags().end());
  return command;
}

std::vector<std::string> Toolchain::compile_command(const std::string& source, const std::string& object,
                                                    Contract contract) {
  std::vector<std::string> command = base_command();
  const bool with_eigen = has_text(read_file(source).value_or(""), "<Eigen/");
  Header& header = with_eigen ? eigen_ : law_;
  if (!header.tried) precompile(header);
  if (contract == Contract::precompiled && !header.dir.empty())
    command.insert(command.end(), {"-I", header.dir});  // before the contract, so that its *.hpp.gch is found first
  if (with_eigen) command.insert(command.end(), {"-include", header.name});
  // Debug information without the scratch folder, so that the same law gives the same object.
  const std::string folder = fs::path(source).parent_path().string();
  command.push_back("-ffile-prefix-map=" + folder + "/=");
  command.insert(command.end(), {"-I", contract_dir_, "-x", "c++", "-c", source, "-o", object});
  return command;
}

// Calls ld directly: the compiler driver would take longer than the link. No library is linked: a law may use what the
// Spine already has (libm), and the dry run's RTLD_NOW finds every missing name.
std::vector<std::string> Toolchain::link_command(const std::string& object, const std::string& library) const {
  return {linker_,           "-shared", "-z", "now",  "-z", "relro", "-z", "noexecstack", "--hash-style=gnu",
          "--build-id=none", object,    "-o", library};
}

// -N: code and constants follow each other without page boundaries. -S: no debug information in the slot.
std::vector<std::string> Toolchain::place_command(const std::string& object, const std::string& script,
                                                  const std::string& program, Lines lines) const {
  std::vector<std::string> command = {linker_, "-static", "-nostdlib", "-N", "-z", "noexecstack", "--build-id=none"};
  if (lines == Lines::none) command.push_back("-S");
  command.insert(command.end(), {"--no-demangle", "-T", script, object, "-o", program});
  return command;
}

}  // namespace lithe::lawd
