// SPDX-License-Identifier: Apache-2.0
// Parses text that the kernel writes. Off the tick.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lithe::host {

// The value behind "name:" at the start of a line (/proc/self/status, /proc/cpuinfo), without spaces around it; empty
// if there is none.
std::string field_of(const std::string& text, const std::string& name);

// The words of a text, separated by spaces, tabs and line ends.
std::vector<std::string> split(std::string_view text);
bool has_word(std::string_view text, std::string_view word);

// The word in brackets: "always [madvise] never" gives "madvise"; empty if there is none.
std::string chosen(const std::string& text);
// The same; the text itself if there is none.
std::string value_in_force(const std::string& text);

// The cores in a mask such as "ff,00000003" (hexadecimal, 32 cores a group). Nothing when the text is no mask.
std::optional<std::vector<int>> parse_mask(const std::string& text);
// The mask of these cores (ascending), as the kernel writes it: "3", "ff,ffffffff"; or with as many digits and commas
// as `like` has, empty when a core does not fit into it.
std::string mask_of(const std::vector<int>& cpus);
std::string mask_of(const std::vector<int>& cpus, const std::string& like);

}  // namespace lithe::host
