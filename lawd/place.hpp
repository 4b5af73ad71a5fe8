// SPDX-License-Identifier: Apache-2.0
// Links a compiled law for one slot of the arena and writes it there.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lawd/toolchain.hpp"
#include "spine/arena/arena.hpp"

namespace lithe::lawd {

// A law as it stands in its slot.
struct Linked {
  std::vector<std::byte> bytes;  // from the slot's start
  std::uint64_t entry = 0;       // address of the law's descriptor
  std::uint64_t hash = 0;        // arena::image_hash
};

// What a relocatable object may not bring along: data that can be written, or code that runs by itself. One sentence
// with the name of what is wrong; empty when there is nothing.
// Contract: any bytes are safe
std::string why_not_placeable(std::string_view object);

// Contract: one thread
class Placer {
 public:
  // `scratch`: a folder for what the linker reads and writes. `arena_fd`: handed over by the supervisor; it is closed
  // here, so that no child can have it.
  Placer(const Toolchain& toolchain, std::string scratch, int arena_fd);

  // Why nothing can be placed; empty when everything can.
  const std::string& error() const { return error_; }

  // The law in `object` (a file), linked for `slot`, written there and tried for so many steps in a child process.
  // `name` tells one law from another in the memory of links. The slot must not be one that anybody runs.
  nlohmann::json place(const std::string& name, const std::string& object, std::uint32_t slot, std::uint32_t joints,
                       std::uint64_t dry_steps);

  // {"ok", "line", "function"} of what lies so many bytes from the start of any slot with the law in `object`: the
  // innermost line that its author wrote, looking through what was inlined. Costs a link.
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
  std::vector<std::pair<std::string, Linked>> links_;  // newest last; a link costs as much as all the rest of a swap
};

}  // namespace lithe::lawd
