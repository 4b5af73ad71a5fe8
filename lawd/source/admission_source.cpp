// SPDX-License-Identifier: Apache-2.0
// The rules for a law's source text. They read tokens, after line joining and without comments. Token pasting is
// refused, so every word that the compiler sees is in the text.
#include <array>

#include "lawd/core/admission.hpp"
#include "lawd/source/admission_tokens.hpp"
#include "lawd/source/admission_words.hpp"
#include "lawd/source/help.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

constexpr std::size_t kMaxSourceBytes = std::size_t{256} << 10;
constexpr std::size_t kMaxNested = 256;  // as C++ asks of a compiler (annex B); g++ needs half a minute for 60,000

class Source {
 public:
  Source(std::string_view text, Admission& out) : text_(text), out_(out) {}

  void check() {
    gate("text", [this] { check_text(); });
    gate("includes", [this] { each_directive([this](std::size_t at) { check_include(at); }); });
    gate("preprocessor", [this] { check_preprocessor(); });
    gate("words", [this] { check_words(); });
    gate("attributes", [this] { check_attributes(); });
  }

 private:
  template <class Body>
  void gate(const char* name, Body body) {
    gate_ = name;
    out_.apply(name, [&body] { return body(), ""; });
  }

  void refuse(const Token& where, std::string message) {
    out_.refuse(gate_, std::move(message), where.line, where.column);
  }

  const Token& at(std::size_t i) const {
    static const Token nothing;
    return i < tokens_.list.size() ? tokens_.list[i] : nothing;
  }
  bool is_mark(std::size_t i, std::string_view mark) const {
    return at(i).kind == TokenKind::mark && at(i).text == mark;
  }

  void check_text() {
    if (text_.size() > kMaxSourceBytes) {
      out_.refuse(gate_, "the source is " + std::to_string(text_.size() / 1024) + " KiB; a law has at most " +
                             std::to_string(kMaxSourceBytes / 1024) +
                             " KiB: shorten tables, compute what can be computed, remove blanks");
      return;
    }
    tokens_ = tokenise(text_);
    if (tokens_.list.empty() && tokens_.ambiguities.empty()) {
      out_.refuse(gate_,
                  std::string("the file holds no code: a law is a struct with Params, State and a static step(), and "
                              "ends with LITHE_LAW(Type, \"name\"); see laws/pd.cpp") +
                      std::string(kWholeLaw),
                  1, 1);
    }
    check_nesting();
    if (text_.find('\0') == std::string_view::npos) check_prose();  // a file with a NUL byte is refused as no text
    for (const Ambiguity& ambiguity : tokens_.ambiguities)
      out_.refuse(gate_, ambiguity.message, ambiguity.line, ambiguity.column);
  }

  void check_nesting() {
    std::size_t depth = 0;
    for (const Token& token : tokens_.list) {
      if (token.kind != TokenKind::mark) continue;
      if (token.text == "(" || token.text == "[" || token.text == "{") ++depth;
      if ((token.text == ")" || token.text == "]" || token.text == "}") && depth > 0) --depth;
      if (depth > kMaxNested) {
        return refuse(token, "brackets are nested more than " + std::to_string(kMaxNested) +
                                 " deep: split the expression, or close what was opened");
      }
    }
  }

  // Words around the code, as a language model writes them.
  void check_prose() {
    static const std::string alone = ": send the file's C++ alone, and put explanations into // comments";
    const auto is_prose = [this](std::size_t i) { return at(i).kind == TokenKind::word && !is_keyword(at(i).text); };
    for (std::size_t i = 0; i < tokens_.list.size(); ++i)
      if (is_mark(i, "`")) return refuse(at(i), "a code fence (```) is not C++" + alone);
    const bool has_own_rule = is_reserved(at(0).text) || !why_word_is_refused(at(0).text).empty();
    if (is_prose(0) && !has_own_rule && !is_mark(1, "::") && !is_mark(1, "("))
      return refuse(at(0), "'" + at(0).text + "' begins no C++ file" + alone +
                               std::string(text_.find("LITHE_LAW") == std::string_view::npos ? kWholeLaw : ""));
    std::size_t end = tokens_.list.size();
    while (end > 0 && at(end - 1).text != "LITHE_LAW") --end;
    if (end == 0) return;
    while (end < tokens_.list.size() && !is_mark(end, ")")) ++end;
    end += is_mark(end + 1, ";") ? 2 : 1;
    if (is_prose(end) && at(end + 1).kind == TokenKind::word && at(end + 2).kind == TokenKind::word)
      refuse(at(end), "'" + at(end).text + "' after LITHE_LAW is no C++" + alone);
  }

  template <class Body>
  void each_directive(Body body) {
    for (std::size_t i = 0; i < tokens_.list.size(); ++i)
      if (at(i).first && is_mark(i, "#")) body(i + 1);
  }
  bool same_directive(std::size_t i) const { return at(i).directive && !at(i).first; }

  void check_include(std::size_t name) {
    const std::string& word = at(name).text;
    if (!same_directive(name) || (word != "include" && word != "include_next" && word != "import")) return;
    if (word != "include") return refuse(at(name), "#" + word + " is not for laws: write #include <...>");
    const Token& target = at(name + 1);
    if (target.kind == TokenKind::header && is_allowed_header(target.text)) return;
    if (target.kind == TokenKind::header || target.kind == TokenKind::text) {
      const std::string quoted = target.kind == TokenKind::text && target.text.size() > 2
                                     ? "<" + target.text.substr(1, target.text.size() - 2) + ">"
                                     : target.text;
      const std::string_view why = why_header_is_refused(quoted);
      refuse(at(name), "a law may not include " + target.text + ": " +
                           (is_allowed_header(quoted) ? "write " + quoted
                            : !why.empty() ? std::string(why)
                                           : "it may include " + allowed_headers_text() +
                                                 ". What it must remember belongs in State, what is tuned in Params"));
    } else {
      refuse(at(name), "an #include must name its file itself, not through a macro");
    }
  }

  void check_preprocessor() {
    each_directive([this](std::size_t at) { check_directive(at); });
    for (const Token& token : tokens_.list)
      if (token.kind == TokenKind::mark && token.text == "##")
        refuse(token, "## glues words together that cannot be checked: write them out");
  }

  void check_directive(std::size_t name) {
    static constexpr std::array<std::string_view, 13> kAllowed = {"include", "if",       "ifdef",  "ifndef", "elif",
                                                                  "else",    "endif",    "define", "undef",  "error",
                                                                  "elifdef", "elifndef", "pragma"};
    if (!same_directive(name)) return;  // a lone "#"
    const std::string& word = at(name).text;
    if (word == "include_next" || word == "import") return;  // reported already
    if (!contains(kAllowed, word))
      refuse(at(name), "#" + word + " is not for laws: remove the line");
    else if (word == "pragma")
      check_pragma(name);
    else if (word == "define" || word == "undef")
      check_macro_name(name + 1);
  }

  void check_pragma(std::size_t name) {
    const std::string& first = at(name + 1).text;
    const std::string& second = at(name + 2).text;
    const bool harmless = first == "once" || (first == "GCC" && (second == "unroll" || second == "ivdep"));
    if (harmless && same_directive(name + 1)) return;
    refuse(at(name),
           "#pragma " + first + (first == "GCC" ? " " + second : "") +
               " changes how the law is compiled or checked: remove it (#pragma GCC unroll and ivdep may stay)");
  }

  void check_macro_name(std::size_t i) {
    const std::string& word = at(i).text;
    if (is_keyword(word) || word == "std" || word == "lithe" || word.starts_with("LITHE")) {
      refuse(
          at(i),
          "the macro " + word +
              " changes what the words of the language or of the contract mean: choose another name, or a constexpr");
    }
  }

  void check_words() {
    for (std::size_t i = 0; i < tokens_.list.size(); ++i) {
      if (at(i).kind != TokenKind::word || (at(i).directive && at(i - 1).first)) continue;  // names of directives
      check_word(i);
    }
  }

  void check_word(std::size_t i) {
    const std::string& word = at(i).text;
    if (const std::string_view why = why_word_is_refused(word); !why.empty()) {
      const bool deleted = word == "delete" && i > 0 && is_mark(i - 1, "=");
      if (!deleted) refuse(at(i), word + ": " + std::string(why));
    } else if (const std::string_view no = why_std_name_is_refused(at(i + 2).text);
               word == "std" && is_mark(i + 1, "::") && !no.empty()) {
      refuse(at(i), "std::" + at(i + 2).text + ": " + std::string(no));
    } else if (const std::string_view not_called = why_call_is_refused(word);
               !not_called.empty() && is_mark(i + 1, "(") && is_call(i)) {
      refuse(at(i), word + ": " + std::string(not_called));
    } else if (is_reserved(word)) {
      refuse(at(i), word +
                        " is a reserved name (it begins with two underscores, or one and a capital): a law uses the "
                        "words of the language, the contract and <cmath>");
    } else if (word == "goto" && is_mark(i + 1, "*")) {
      refuse(at(i), "goto to a computed address: use if, switch or a loop");
    } else if (word == "namespace" && at(i - 1).text == "using" &&
               (at(i + 1).text == "std" || at(i + 1).text == "lithe")) {
      const std::string& which = at(i + 1).text;
      refuse(at(i - 1),
             "using namespace " + which + " brings in names that may be meant otherwise: remove the line and write " +
                 (which == "std" ? "std::sin (or: using std::sin;)" : "lithe::Tick (or: using lithe::Tick;)"));
    } else if (word == "namespace" && (at(i + 1).text == "std" || at(i + 1).text == "lithe")) {
      refuse(at(i), "nothing may be added to namespace " + at(i + 1).text + ": use a name of your own");
    } else if (word == "lithe" && is_mark(i + 1, "::") &&
               (at(i + 2).text == "contract" || at(i + 2).text == "reflect")) {
      refuse(at(i), "lithe::" + at(i + 2).text +
                        " is the inside of the contract: a law uses lithe::Tick, lithe::Effort, lithe::Param, "
                        "lithe::JointArray and the constants");
    }
  }

  // Not a member, not of a namespace, and not a function of the law's own: double rand(...).
  bool is_call(std::size_t i) const {
    if (is_mark(i - 1, "::") || is_mark(i - 1, ".")) return false;
    return at(i - 1).kind != TokenKind::word || at(i - 1).text == "return";
  }

  // [[ ... ]]: two tokens, possibly with blanks between them.
  void check_attributes() {
    for (std::size_t i = 0; i + 1 < tokens_.list.size(); ++i) {
      if (!is_mark(i, "[") || !is_mark(i + 1, "[")) continue;
      for (std::size_t k = i + 2; k < tokens_.list.size() && !is_mark(k, "]"); ++k) check_attribute(k);
    }
  }

  void check_attribute(std::size_t i) {
    if (at(i).kind != TokenKind::word) return;
    const bool in_namespace = is_mark(i - 1, "::");
    if (!in_namespace && is_mark(i + 1, "::") && at(i).text == "gnu") return;  // the word after it is checked
    if (is_allowed_attribute(at(i).text, in_namespace)) return;
    refuse(at(i), "the attribute " + at(i).text +
                      " is not for laws: remove it (allowed: likely, unlikely, maybe_unused, nodiscard, fallthrough, "
                      "gnu::always_inline, gnu::noinline)");
  }

  std::string_view text_;
  Admission& out_;
  Tokens tokens_;
  const char* gate_ = "";
};

}  // namespace

void admit_source(std::string_view source, Admission& out) { Source(source, out).check(); }

}  // namespace lithe::lawd
