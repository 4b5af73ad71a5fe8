// SPDX-License-Identifier: Apache-2.0
// SHA-256 (FIPS 180-4): names cache entries and notices damaged ones.
#pragma once

#include <string>
#include <string_view>

namespace lithe::lawd {

// Lower-case hex, 64 characters.
std::string sha256_hex(std::string_view bytes);

}  // namespace lithe::lawd
