// SPDX-License-Identifier: Apache-2.0
#include "spine/code_arena.hpp"

#include <utility>

namespace lithe {

Result<std::unique_ptr<load::ArenaStore>> attach_code_arena(const robot::RobotConfig& robot) {
  std::unique_ptr<load::ArenaStore> store;
  if (robot.spine.loader == robot::LawLoader::dlopen) return store;
  const auto refused = [](const std::string& why) {
    return Error{"laws are loaded with dlopen, which interrupts the Spine's core at every swap: " + why};
  };
  if (!arena::is_memory(arena::kHandedFd)) return refused("no code arena was handed over");
  if (const Result<> kept = arena::make_read_only(arena::kHandedFd); !kept) return refused(kept.message());
  Result<arena::Arena> mapped = arena::Arena::attach_exec(arena::kHandedFd);
  if (!mapped) return refused(mapped.message());
  store = std::make_unique<load::ArenaStore>(std::move(*mapped));
  return store;
}

}  // namespace lithe
