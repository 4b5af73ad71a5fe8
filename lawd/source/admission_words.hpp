// SPDX-License-Identifier: Apache-2.0
// Word lists of the admission rules: headers, names and functions, with what to use instead.
#pragma once

#include <string>
#include <string_view>

namespace lithe::lawd {

// `header` with its <> or "".
bool is_allowed_header(std::string_view header);
std::string allowed_headers_text();
// What to use instead of what this header brings; empty when that is not known.
std::string_view why_header_is_refused(std::string_view header);

bool is_keyword(std::string_view word);
// True for a name reserved for the compiler and its library, except the harmless ones.
bool is_reserved(std::string_view word);
// Why a law may not use this word; empty = allowed.
std::string_view why_word_is_refused(std::string_view word);
// The same for std::NAME, and for a function that is called by its bare name: printf(...).
std::string_view why_std_name_is_refused(std::string_view name);
std::string_view why_call_is_refused(std::string_view name);
bool is_allowed_attribute(std::string_view name, bool in_namespace);

// True for an external symbol that a law may call: mathematics and memory copies. None of them waits, allocates, writes
// elsewhere or exits. The arena's stub table has an entry for each.
bool is_allowed_symbol(std::string_view symbol);
// What to use instead of `symbol`. `readable`: its demangled name.
std::string why_symbol_is_refused(std::string_view symbol, std::string_view readable);

}  // namespace lithe::lawd
