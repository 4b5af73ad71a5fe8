// SPDX-License-Identifier: Apache-2.0
// Checks that bytes from outside are text, and that the text is safe to show; compares words. Off the tick.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace lithe {

// The offset of the first byte that is not plain text (bad UTF-8, or a control character other than tab and line
// ends), or npos: a binary or a file in another encoding gets one clear message.
std::size_t first_non_text(std::string_view bytes);

// The rule for every name and every other short word from outside: well-formed UTF-8 (Unicode 15, table 3-7: nothing
// overlong, no surrogates), no control character (C0, DEL, C1), no tab or line end, and no invisible character or one
// that changes the writing direction (U+00AD, U+061C, U+200B..200F, U+2028..202E, U+2060..206F, U+FEFF, U+FFF9..FFFB,
// tags U+E0000..E0FFF). So it is shown unchanged, in one line, on every terminal.
bool is_printable(std::string_view text);

// The same bytes with everything unprintable escaped: "\x1b" for bytes below 0x80 and for bytes that are no UTF-8,
// "\u202e" for characters. Line ends and tabs stay when `keep_lines`.
std::string printable(std::string_view text, bool keep_lines = false);

// The text as one word of a shell's command, in single quotes where it needs them.
std::string shell_word(std::string_view text);

// From one word to the other: insertions, deletions, replacements and swaps of neighbours each cost one.
std::size_t edit_distance(std::string_view a, std::string_view b);

}  // namespace lithe
