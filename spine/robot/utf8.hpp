// SPDX-License-Identifier: Apache-2.0
// Whether bytes are text at all, asked before the TOML parser sees them.
#pragma once

#include <cstddef>
#include <string_view>

namespace lithe::robot {

// The offset of the first byte that is not plain text (bad UTF-8, or a control character other than tab and line
// ends), or npos: a binary or a file in another encoding gets one clear message.
std::size_t first_non_text(std::string_view bytes);

}  // namespace lithe::robot
