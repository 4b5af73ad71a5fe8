// SPDX-License-Identifier: Apache-2.0
// Links a compiled law for one slot of the arena and writes it there.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lawd/compile/toolchain.hpp"
#include "spine/arena/arena.hpp"

namespace lithe::lawd {

// A law linked for its slot.
struct Linked {
  std::vector<std::byte> bytes;  // from the slot's start
  std::uint64_t entry = 0;       // address of the law's descriptor
  std::uint64_t hash = 0;        // arena::image_hash
};

// Why a relocatable object cannot be placed: it has writable data, or code that runs at load time. One sentence with
// the name; empty = it can.
// Contract: any bytes are safe
std::string why_not_placeable(std::string_view object);

// Contract: one thread
class Placer {
 public:
  // `scratch`: folder for the linker's files. `arena_fd`: from the supervisor; closed here after mapping, so that no
  // child inherits it.
  Placer(const Toolchain& toolchain, std::string scratch, int arena_fd);

  // Why no law can be placed; empty = placing works.
  const std::string& error() const { return error_; }

  // The law in `object` (a file), linked for `slot` and written there. None of its code runs here: the trial is the
  // first to run it from the slot. `name` is the key in the cache of links. No process may be running a law in this
  // slot.
  nlohmann::json place(const std::string& name, const std::string& object, std::uint32_t slot);

  // {"ok", "line", "function"} of the code at this offset [bytes] from the start of a slot with the law in `object`:
  // the innermost line of the law's source, also for inlined code. Links once.
  nlohmann::json locate(const std::string& object, std::uint32_t offset) const;

 private:
  struct Failure {
    std::string stage, text;
    bool starved = false;
  };
  std::optional<Failure> link(const std::string& object, std::uint32_t slot, Linked& linked) const;
  Linked* remembered(const std::string& name, std::uint32_t slot);

  const Toolchain& toolchain_;
  std::string scratch_;
  std::optional<arena::Writer> writer_;
  std::string error_;
  std::vector<std::pair<std::string, Linked>> links_;  // newest last; a cache, because a link takes long
};

}  // namespace lithe::lawd
