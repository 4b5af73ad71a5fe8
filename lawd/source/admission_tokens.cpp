// SPDX-License-Identifier: Apache-2.0
#include "lawd/source/admission_tokens.hpp"

#include <cstdint>

namespace lithe::lawd {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_word_start(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' || c == '$' ||
         static_cast<unsigned char>(c) >= 0x80;
}
bool is_word(char c) { return is_word_start(c) || is_digit(c); }
bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f' || c == '\r'; }

// The text with joined lines, and the original position of each character.
struct Joined {
  std::string text;
  std::vector<std::uint32_t> line, column;
};

// Two lines are joined by a backslash, optional blanks (the compiler ignores them) and the line end.
std::size_t splice_length(std::string_view source, std::size_t at) {
  std::size_t end = at + 1;
  while (end < source.size() && is_blank(source[end])) ++end;
  return end < source.size() && source[end] == '\n' ? end + 1 - at : 0;
}

Joined join(std::string_view source) {
  Joined out;
  out.text.reserve(source.size() + 1);
  std::uint32_t line = 1, column = 1;
  for (std::size_t i = 0; i < source.size();) {
    if (source[i] == '\\') {
      if (const std::size_t skip = splice_length(source, i)) {
        i += skip;
        ++line;
        column = 1;
        continue;
      }
    }
    out.text += source[i];
    out.line.push_back(line);
    out.column.push_back(column++);
    if (source[i++] == '\n') {
      ++line;
      column = 1;
    }
  }
  out.text += '\n';
  out.line.push_back(line);
  out.column.push_back(column);
  return out;
}

// U+202A..202E, U+2066..2069, U+200E, U+200F: invisible characters that change the shown order of text. At `at`: E2 80
// xx or E2 81 xx.
bool is_bidi(std::string_view text, std::size_t at) {
  if (at + 2 >= text.size() || text[at] != '\xE2') return false;
  const auto second = static_cast<unsigned char>(text[at + 1]), third = static_cast<unsigned char>(text[at + 2]);
  if (second == 0x80) return third == 0x8E || third == 0x8F || (third >= 0xAA && third <= 0xAE);
  return second == 0x81 && third >= 0xA6 && third <= 0xA9;
}

class Reader {
 public:
  explicit Reader(std::string_view source) : joined_(join(source)), text_(joined_.text) {}

  Tokens read() {
    look_for_odd_bytes();
    while (at_ < text_.size()) step();
    return std::move(out_);
  }

 private:
  void ambiguity(std::size_t at, std::string message) {
    if (out_.ambiguities.size() < 8) {
      out_.ambiguities.push_back(
          {std::move(message), static_cast<int>(joined_.line[at]), static_cast<int>(joined_.column[at])});
    }
  }

  void look_for_odd_bytes() {
    if (const std::size_t zero = text_.find('\0'); zero != std::string::npos)
      return ambiguity(zero, "a zero byte, so this is no plain text: a law is C++, saved as UTF-8");
    for (std::size_t i = 0; i < text_.size(); ++i) {
      const char c = text_[i];
      const bool odd_return = c == '\r' && i + 1 < text_.size() && text_[i + 1] != '\n';
      if ((static_cast<unsigned char>(c) < 0x20 && c != '\n' && !is_blank(c)) || c == '\x7f' || odd_return) {
        ambiguity(i, "a control character in the text: remove it");
      } else if (is_bidi(text_, i)) {
        ambiguity(i,
                  "a character that changes the direction of writing: remove it, the text must read as it is compiled");
      } else if (c == '?' && i + 2 < text_.size() && text_[i + 1] == '?' &&
                 std::string_view("=/'()!<>-").find(text_[i + 2]) != std::string_view::npos) {
        ambiguity(i, "a trigraph (two question marks): write the character itself");
      }
    }
  }

  char peek(std::size_t ahead = 0) const { return at_ + ahead < text_.size() ? text_[at_ + ahead] : '\n'; }

  void emit(TokenKind kind, std::size_t from, std::string text) {
    Token token{kind, std::move(text), static_cast<int>(joined_.line[from]), static_cast<int>(joined_.column[from])};
    token.first = fresh_line_;
    if (fresh_line_ && kind == TokenKind::mark && token.text == "#") in_directive_ = true;
    token.directive = in_directive_;
    fresh_line_ = false;
    out_.list.push_back(std::move(token));
  }

  void step() {
    const char c = peek();
    if (c == '\n') {
      fresh_line_ = true;
      in_directive_ = false;
      ++at_;
    } else if (is_blank(c)) {
      ++at_;
    } else if (c == '/' && peek(1) == '/') {
      while (peek() != '\n') ++at_;
    } else if (c == '/' && peek(1) == '*') {
      comment();
    } else if (is_word_start(c)) {
      word();
    } else if (is_digit(c) || (c == '.' && is_digit(peek(1)))) {
      number();
    } else if (c == '<' && after_include()) {
      header();
    } else if (c == '"' || c == '\'') {
      literal(at_, c);
    } else {
      mark();
    }
  }

  void comment() {
    const std::size_t end = text_.find("*/", at_ + 2);
    if (end == std::string_view::npos) ambiguity(at_, "a comment without an end: close it with */");
    at_ = end == std::string_view::npos ? text_.size() : end + 2;
  }

  void word() {
    const std::size_t from = at_;
    while (is_word(peek())) ++at_;
    std::string name(text_.substr(from, at_ - from));
    const bool prefix = name == "u8" || name == "u" || name == "U" || name == "L";
    const bool raw = name == "R" || name == "u8R" || name == "uR" || name == "UR" || name == "LR";
    if (raw && peek() == '"') {
      ambiguity(from, "a raw string: write an ordinary string literal, a law needs no other");
      at_ = text_.size();
    } else if (prefix && (peek() == '"' || peek() == '\'')) {
      literal(from, peek());
    } else {
      emit(TokenKind::word, from, std::move(name));
    }
  }

  void number() {
    const std::size_t from = at_++;
    for (;; ++at_) {
      const char c = peek(), before = text_[at_ - 1];
      const bool exponent =
          (c == '+' || c == '-') && (before == 'e' || before == 'E' || before == 'p' || before == 'P');
      const bool separator = c == '\'' && is_word(peek(1));
      if (!is_word(c) && c != '.' && !exponent && !separator) break;
    }
    emit(TokenKind::number, from, std::string(text_.substr(from, at_ - from)));
  }

  void literal(std::size_t from, char quote) {
    ++at_;
    while (peek() != quote && peek() != '\n') at_ += peek() == '\\' ? 2 : 1;
    if (peek() != quote || at_ >= text_.size())
      ambiguity(from, std::string("a literal without an end: close it with ") + quote + " on its own line");
    else
      ++at_;
    if (at_ > text_.size()) at_ = text_.size();
    emit(quote == '"' ? TokenKind::text : TokenKind::character, from, std::string(text_.substr(from, at_ - from)));
  }

  bool after_include() const {
    const auto& list = out_.list;
    if (list.size() < 2 || fresh_line_ || !in_directive_) return false;
    const Token &name = list.back(), &hash = list[list.size() - 2];
    return hash.text == "#" && hash.first && name.kind == TokenKind::word &&
           (name.text == "include" || name.text == "include_next" || name.text == "import");
  }

  void header() {
    const std::size_t from = at_;
    while (peek() != '>' && peek() != '\n') ++at_;
    if (peek() == '>') ++at_;
    emit(TokenKind::header, from, std::string(text_.substr(from, at_ - from)));
  }

  void mark() {
    struct Spelling {
      std::string_view written, meant;
    };
    static constexpr Spelling kLong[] = {{"%:%:", "##"}, {"#%:", "##"}, {"%:#", "##"}, {"##", "##"}, {"::", "::"},
                                         {"%:", "#"},    {"<:", "["},   {":>", "]"},   {"<%", "{"},  {"%>", "}"}};
    const std::size_t from = at_;
    // The standard's one exception: "<::" is "<" and "::" unless ":" or ">" follows.
    const bool less = text_.substr(at_).starts_with("<::") && peek(3) != ':' && peek(3) != '>';
    if (peek() == '\\') ambiguity(from, "a backslash outside a literal: write plain names");
    for (const Spelling& spelling : kLong) {
      if (less || !text_.substr(at_).starts_with(spelling.written)) continue;
      at_ += spelling.written.size();
      return emit(TokenKind::mark, from, std::string(spelling.meant));
    }
    ++at_;
    emit(TokenKind::mark, from, std::string(1, text_[from]));
  }

  Joined joined_;
  std::string_view text_;
  std::size_t at_ = 0;
  bool fresh_line_ = true;
  bool in_directive_ = false;
  Tokens out_;
};

}  // namespace

Tokens tokenise(std::string_view source) {
  if (source.starts_with("\xEF\xBB\xBF")) source.remove_prefix(3);  // a byte-order mark, which the compiler skips too
  return Reader(source).read();
}

}  // namespace lithe::lawd
