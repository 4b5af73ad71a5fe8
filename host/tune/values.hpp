// SPDX-License-Identifier: Apache-2.0
// Values as the kernel writes them in its files.
#pragma once

#include <string>
#include <vector>

namespace lithe::host {

// Whether two ascending lists of cores have one in common.
bool share_a_core(const std::vector<int>& some, const std::vector<int>& others);

// The cores that are in `cores` and not in `others`; both ascending.
std::vector<int> cores_without(const std::vector<int>& cores, const std::vector<int>& others);

// A mask of these cores with as many digits and commas as `like` has. Empty when a core does not fit into it.
std::string mask_of(const std::vector<int>& cores, const std::string& like);

// The value that is in force: "madvise" of "always [madvise] never", else the text itself.
std::string value_in_force(const std::string& text);

}  // namespace lithe::host
