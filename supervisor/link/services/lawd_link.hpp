// SPDX-License-Identifier: Apache-2.0
// The supervisor's connection to the compile service (lawd).
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "supervisor/link/services/service_link.hpp"

namespace lithe::control {

struct LawText {
  std::string name;
  std::string source;
  std::uint32_t budget_ns = 0;  // time limit of a step; 0 = not checked
};

// Location of a law, as lawd reported it. slot 0: not in the arena; it is loaded with dlopen.
struct Placed {
  std::uint32_t slot = 0;
  std::uint32_t code_bytes = 0;
  std::uint64_t entry = 0;
  std::uint64_t image_hash = 0;
  double place_ms = 0.0;
};

// Contract: as ServiceLink. Answers are lawd's own on success; a Refusal carries the diagnostics in `detail`.
class LawdLink : public ServiceLink {
 public:
  using PlacedCallback = std::function<void(const std::variant<Placed, Refusal>&)>;
  static constexpr std::size_t kMaxChecks = 8;

  // `program`: path of lawd. `cpus`: cores that lawd and its compilers may use. `joints`: number of joints in the dry
  // run. `compile_s`: processor time for the compiler of one law.
  LawdLink(std::string program, std::vector<int> cpus, std::size_t joints, double compile_s = 20.0);

  // For one answer, from when lawd receives the request: the compiler waits for the processor, too.
  std::int64_t limit_ns() const { return limit_ns_; }

  // Switches admission and dry run off: for tests of the containment in the Spine.
  void open_gates() { gates_ = false; }

  void compile(const LawText& law, Callback callback, std::int64_t now_ns);
  // The same for `law check`: every compile() goes first, and at most kMaxChecks wait.
  void check(const LawText& law, Callback callback, std::int64_t now_ns);
  // Links a compiled law for a slot of the arena and writes it there. `hash`: from the answer to compile().
  void place(const std::string& hash, std::uint32_t slot, PlacedCallback callback, std::int64_t now_ns);
  // Answers {"line", "function"} for an offset [bytes] from the start of the law's slot, or of its object.
  void locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback, std::int64_t now_ns);

 private:
  Json compile_request(const LawText& law) const;

  std::size_t joints_;
  std::int64_t limit_ns_;
  bool gates_ = true;
};

}  // namespace lithe::control
