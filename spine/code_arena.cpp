// SPDX-License-Identifier: Apache-2.0
#include "spine/code_arena.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <utility>

#include "spine/core/host/fd.hpp"

namespace lithe {
namespace {

// By default a core dump leaves out private mappings of files (core(5)), and the kernel takes the arena for one: gdb
// would show zeros for a law's code. Without the file (no core dumps in this kernel) there is nothing to do.
void keep_arena_in_cores() {
  const Fd filter(::open("/proc/self/coredump_filter", O_WRONLY | O_CLOEXEC));
  if (filter) (void)!::write(filter.get(), "0x37", 4);
}

}  // namespace

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
  keep_arena_in_cores();
  store = std::make_unique<load::ArenaStore>(std::move(*mapped));
  return store;
}

}  // namespace lithe
