// SPDX-License-Identifier: Apache-2.0
// A law's text as the compiler's own first phases see it: lines joined, comments gone, tokens with their place.
#pragma once

#include <cstddef>
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
  bool first = false;      // of its line: a mark "#" there begins a directive
  bool directive = false;  // belongs to a directive (also the "#")
  bool glued = false;      // nothing stands between it and the token before
};

struct Trouble {
  std::string message;
  int line = 0;
  int column = 0;
};

struct Tokens {
  std::vector<Token> list;
  std::vector<Trouble> troubles;  // what two readers of this text could understand differently
};

// Contract: any bytes are safe · linear in the size of `source`
Tokens tokenise(std::string_view source);

}  // namespace lithe::lawd
