// SPDX-License-Identifier: Apache-2.0
// Packed files of the kernel. Off the tick.
#pragma once

#include <cstddef>
#include <string>

#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

// The text of a file packed with gzip: /proc/config.gz. An error, which names the file, when it is absent, not packed,
// damaged, cut short, or larger than that once unpacked.
Result<std::string> read_packed(const HostFiles& files, const std::string& path, std::size_t most_bytes);

}  // namespace lithe::host
