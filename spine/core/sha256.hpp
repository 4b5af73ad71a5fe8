// SPDX-License-Identifier: Apache-2.0
// SHA-256 (FIPS 180-4): names laws by their content, notices damaged files, chains certificates.
#pragma once

#include <string>
#include <string_view>

namespace lithe {

// Lower-case hex, 64 characters.
std::string sha256_hex(std::string_view bytes);

}  // namespace lithe
