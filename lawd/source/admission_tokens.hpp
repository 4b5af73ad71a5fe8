// SPDX-License-Identifier: Apache-2.0
// Tokenizer for a law's text, like the compiler's first phases: joins lines, drops comments, keeps positions.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace lithe::lawd {

enum class TokenKind { word, number, text, character, header, mark };

struct Token {
  TokenKind kind = TokenKind::mark;
  std::string text;  // header: with its <> or ""; mark: one character, or :: or ##; a digraph as what it means
  int line = 0;
  int column = 0;
  bool first = false;      // first in its line: "#" there begins a directive
  bool directive = false;  // part of a directive (also the "#")
};

struct Ambiguity {
  std::string message;
  int line = 0;
  int column = 0;
};

struct Tokens {
  std::vector<Token> list;
  std::vector<Ambiguity> ambiguities;  // text that a person and the compiler could read differently
};

// Contract: any bytes are safe · linear in the size of `source`
Tokens tokenise(std::string_view source);

}  // namespace lithe::lawd
