// SPDX-License-Identifier: Apache-2.0
// SHA-256 by libmd: names laws by their content, notices damaged files, chains certificates. A room that includes this
// links lithe::md (cmake/libraries.cmake); the Spine does not.
#pragma once

#include <sha256.h>

#include <cstdint>
#include <string>
#include <string_view>

namespace lithe {

// Lower-case hex, 64 characters.
inline std::string sha256_hex(std::string_view bytes) {
  std::string hex(SHA256_DIGEST_STRING_LENGTH - 1, '\0');
  SHA256Data(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size(), hex.data());
  return hex;
}

}  // namespace lithe
