// SPDX-License-Identifier: Apache-2.0
// Laws as shared objects, through the dynamic linker.
#pragma once

#include <array>

#include "spine/load/law_store.hpp"

namespace lithe::load {

// Why the file at `path` must not be given to dlopen: not a regular file, not an ELF shared object of this machine, or
// truncated (the linker would map past its end, and the process would get SIGBUS). nullptr when it may.
// Contract: off the tick · allocates nothing · any bytes are safe
const char* check_object(const char* path);

// Contract: see LawStore · allocates nothing but what dlopen does itself
class DlopenStore final : public LawStore {
 public:
  ~DlopenStore() override;
  wire::StageResult load(std::uint32_t place, const wire::StageRequest& request, const LitheLaw*& law,
                         std::span<char> why) override;
  void unload(std::uint32_t place) override;

 private:
  const LitheLaw* open(std::uint32_t place, const char* path, std::span<char> why);

  std::array<void*, law::kResidents> handles_{};
};

}  // namespace lithe::load
