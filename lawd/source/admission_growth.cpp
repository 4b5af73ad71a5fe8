// SPDX-License-Identifier: Apache-2.0
// A macro is judged where it is used, by all definitions that its name has anywhere; the order of lines is ignored.
#include "lawd/source/admission_growth.hpp"

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace lithe::lawd {
namespace {

constexpr double kMost = 1e12;  // sums and products stay finite
constexpr int kMaxDepth = 100;  // nesting of macros, also in arguments: this check recurses as deep

using Words = std::vector<const Token*>;

struct Definition {
  std::vector<std::string_view> params;
  Words body;
};

// Size of an expansion: a constant number of words, plus a number of repetitions for each parameter of the enclosing
// definition.
struct Size {
  double words = 0;
  std::vector<double> times;

  explicit Size(std::size_t params) : times(params) {}
  void add(const Size& other, double factor) {
    words = std::min(kMost, words + factor * other.words);
    for (std::size_t i = 0; i < times.size(); ++i) times[i] = std::min(kMost, times[i] + factor * other.times[i]);
  }
};

struct Macro {
  std::vector<Definition> definitions;
  bool has_arguments = false;
  enum class Seen { no, open, done } seen = Seen::no;
  double words = 1;     // own words,
  double argument = 1;  // and how often each word of its arguments is repeated, at most
};

bool is_mark(const Token& token, std::string_view mark) { return token.kind == TokenKind::mark && token.text == mark; }
bool is_word(const Token& token) { return token.kind == TokenKind::word; }

class Growth {
 public:
  Growth(const Tokens& tokens, std::size_t most_words, const char* gate, Admission& out)
      : most_words_(static_cast<double>(most_words)), gate_(gate), out_(out) {
    const std::vector<Token>& list = tokens.list;
    for (std::size_t i = 0; i < list.size();) {
      if (list[i].first && is_mark(list[i], "#")) {
        i = read_directive(list, i + 1);
      } else {
        text_.push_back(&list[i++]);
      }
    }
  }

  void check() {
    Size total(0);
    for (std::size_t i = 0; i < text_.size() && !refused_;) {
      const Token& where = *text_[i];
      i = take(text_, i, nullptr, nullptr, total);
      if (total.words > most_words_) {
        refuse(where, "the macros of this law grow to more than " + std::to_string(static_cast<long>(most_words_)) +
                          " words: write a loop or a function");
      }
    }
  }

 private:
  // Records definitions. Conditions count as text, since macros expand there too. Returns the index after the
  // directive.
  std::size_t read_directive(const std::vector<Token>& list, std::size_t i) {
    std::size_t end = i;
    while (end < list.size() && list[end].directive && !list[end].first) ++end;
    if (i == end) return end;
    const std::string& name = list[i].text;
    if (name == "define" && i + 1 < end) {
      define(list, i + 1, end);
    } else if (name == "if" || name == "elif") {
      for (std::size_t k = i + 1; k < end; ++k) {
        if (list[k].text == "defined") {
          k += k + 1 < end && is_mark(list[k + 1], "(") ? 2 : 1;  // skip the parameter's name
        } else {
          text_.push_back(&list[k]);
        }
      }
    }
    return end;
  }

  void define(const std::vector<Token>& list, std::size_t name, std::size_t end) {
    Definition made;
    std::size_t i = name + 1;
    const bool has_arguments = i < end && is_mark(list[i], "(") && list[i].glued;
    if (has_arguments) {
      for (++i; i < end && !is_mark(list[i], ")"); ++i) {
        if (is_word(list[i])) made.params.push_back(list[i].text);
      }
      ++i;
    }
    for (; i < end; ++i) {
      if (is_mark(list[i], "#")) refuse(list[i], "# makes a text of words, which a law has no use for: remove it");
      made.body.push_back(&list[i]);
    }
    Macro& macro = macros_[list[name].text];
    macro.has_arguments = macro.has_arguments || has_arguments;
    macro.definitions.push_back(std::move(made));
  }

  // Adds the expansion of the word at `i`, with its arguments if any. Returns the index after it.
  std::size_t take(const Words& words, std::size_t i, const Definition* in, const Macro* inside, Size& size) {
    const Token& word = *words[i];
    if (in != nullptr && is_word(word)) {
      const auto param = std::find(in->params.begin(), in->params.end(), word.text);
      if (param != in->params.end()) {
        double& times = size.times[static_cast<std::size_t>(param - in->params.begin())];
        times = std::min(kMost, times + 1);
        return i + 1;
      }
    }
    const auto found = is_word(word) ? macros_.find(word.text) : macros_.end();
    if (found == macros_.end() || &found->second == inside) {  // a macro is not expanded inside itself
      size.words += 1;
      return i + 1;
    }
    Macro& macro = found->second;
    measure(macro, word);
    size.words = std::min(kMost, size.words + macro.words);
    if (!macro.has_arguments) return i + 1;
    Size arguments(size.times.size());
    const std::size_t end = take_arguments(words, i + 1, in, inside, arguments);
    if (end == 0) {
      refuse(word,
             "the macro " + word.text + " without its arguments, between ( and ): what becomes of it is not known");
      return words.size();
    }
    size.add(arguments, std::max(1.0, macro.argument));
    return end;
  }

  // Length from "(" to its ")"; 0 when there are none.
  std::size_t take_arguments(const Words& words, std::size_t i, const Definition* in, const Macro* inside,
                             Size& arguments) {
    if (i >= words.size() || !is_mark(*words[i], "(") || !enter(*words[i])) return 0;
    int open = 0;
    while (i < words.size() && !refused_) {
      open += is_mark(*words[i], "(") ? 1 : is_mark(*words[i], ")") ? -1 : 0;
      if (open == 0) break;
      i = take(words, i, in, inside, arguments);
    }
    --depth_;
    return open == 0 && i < words.size() ? i + 1 : 0;
  }

  void measure(Macro& macro, const Token& used) {
    if (macro.seen == Macro::Seen::done || refused_) return;
    if (macro.seen == Macro::Seen::open) {
      refuse(used, "the macro " + used.text + " comes back to itself through others: write it out");
      return;
    }
    if (!enter(used)) return;
    macro.seen = Macro::Seen::open;
    double most_words = 1, most_argument = 1;
    for (const Definition& definition : macro.definitions) {
      Size size(definition.params.size());
      for (std::size_t i = 0; i < definition.body.size() && !refused_;) {
        i = take(definition.body, i, &definition, &macro, size);
      }
      most_words = std::max(most_words, size.words);
      for (const double times : size.times) most_argument = std::max(most_argument, times);
    }
    macro.words = most_words;
    macro.argument = most_argument;
    macro.seen = Macro::Seen::done;
    --depth_;
  }

  bool enter(const Token& where) {
    if (++depth_ <= kMaxDepth) return true;
    refuse(where, "macros inside of more than " + std::to_string(kMaxDepth) + " others: write them out");
    return false;
  }

  void refuse(const Token& where, std::string message) {
    if (!refused_) out_.refuse(gate_, std::move(message), where.line, where.column);
    refused_ = true;
  }

  const double most_words_;
  const char* gate_;
  Admission& out_;
  Words text_;
  std::map<std::string_view, Macro> macros_;
  int depth_ = 0;
  bool refused_ = false;
};

}  // namespace

void check_growth(const Tokens& tokens, std::size_t most_words, const char* gate, Admission& out) {
  Growth(tokens, most_words, gate, out).check();
}

}  // namespace lithe::lawd
