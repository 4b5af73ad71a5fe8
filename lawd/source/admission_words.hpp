// SPDX-License-Identifier: Apache-2.0
// The words of the admission rules: what a law may include, say and call, and what to do instead.
#pragma once

#include <string>
#include <string_view>

namespace lithe::lawd {

// `header` with its <> or "".
bool is_allowed_header(std::string_view header);
std::string allowed_headers_text();

bool is_keyword(std::string_view word);
// A name that only the compiler and its library may use; the harmless ones are not counted.
bool is_reserved(std::string_view word);
// Why a law may not say this word; empty when it may.
std::string_view why_word_is_refused(std::string_view word);
bool is_allowed_attribute(std::string_view name, bool in_namespace);

// A name of another object that a law may use: mathematics and the copying of memory, nothing that can wait, allocate,
// write elsewhere or leave. The arena's stub table has an entry for each of these.
bool is_allowed_symbol(std::string_view symbol);
// What a law that uses `symbol` should do instead. `readable`: its demangled name.
std::string why_symbol_is_refused(std::string_view symbol, std::string_view readable);

}  // namespace lithe::lawd
