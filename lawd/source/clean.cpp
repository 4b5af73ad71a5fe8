// SPDX-License-Identifier: Apache-2.0
#include "lawd/source/clean.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <iterator>
#include <optional>

#include "lawd/source/admission_tokens.hpp"
#include "lawd/source/help.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

constexpr const char* kTextGate = "text";
constexpr std::string_view kBlanks = " \t\r\v\f";

std::string_view trimmed(std::string_view line) {
  const std::size_t from = std::min(line.find_first_not_of(kBlanks), line.size());
  line.remove_prefix(from);
  return line.substr(0, line.find_last_not_of(kBlanks) + 1);
}

// Whether a comment is open at the line's end. Apostrophes are no literals here: prose has them, too.
bool comment_is_open(std::string_view line, bool open) {
  for (std::size_t i = 0; i < line.size(); ++i) {
    const std::string_view rest = line.substr(i);
    if (open) {
      if (rest.starts_with("*/")) open = false, ++i;
    } else if (rest.starts_with("//")) {
      return false;
    } else if (rest.starts_with("/*")) {
      open = true, ++i;
    } else if (line[i] == '"') {
      for (++i; i < line.size() && line[i] != '"'; ++i) i += line[i] == '\\' ? 1 : 0;
    }
  }
  return open;
}

bool is_directive(std::string_view line) {
  static constexpr std::array<std::string_view, 10> kNames = {"include", "define", "undef", "if",    "ifdef",
                                                              "ifndef",  "elif",   "else",  "endif", "pragma"};
  line = trimmed(line);
  if (!line.starts_with("#")) return false;
  const std::string_view name = trimmed(line.substr(1));
  return std::ranges::any_of(kNames, [name](std::string_view each) { return name.starts_with(each); });
}

bool is_include(std::string_view line) {
  return is_directive(line) && trimmed(trimmed(line).substr(1)).starts_with("include");
}

bool is_comment(std::string_view line) {
  line = trimmed(line);
  return line.empty() || line.starts_with("//") || line.starts_with("/*");
}

// A sentence rarely ends like this; in C++ most lines do.
bool looks_like_code(std::string_view line) {
  line = trimmed(line);
  return !line.empty() && std::string_view(";{}\\").find(line.back()) != std::string_view::npos;
}

bool is_fence(std::string_view line) {
  line = trimmed(line);
  return line.starts_with("```") || line.starts_with("~~~");
}

bool has_law(std::string_view line) { return line.find("LITHE_LAW(") != std::string_view::npos; }

// Lines [from, to).
struct Block {
  std::size_t from = 0, to = 0;
};

// What is written in place of a character of a web page or of a text processor.
struct Spelling {
  std::string_view written, meant, word;  // `word`: of an HTML escape
};
constexpr auto kSpellings = std::to_array<Spelling>({
    {"&lt;", "<", "lt"},        {"&gt;", ">", "gt"},       {"&amp;", "&", "amp"},     {"&quot;", "\"", "quot"},
    {"&apos;", "'", "apos"},    {"&nbsp;", " ", "nbsp"},   {"&#39;", "'", ""},        {"&#34;", "\"", ""},
    {"&#x27;", "'", ""},        {"&#60;", "<", ""},        {"&#62;", ">", ""},        {"&#38;", "&", ""},
    {"\xC2\xA0", " ", ""},      {"\xE2\x80\xAF", " ", ""}, {"\xE2\x80\x8B", "", ""},  {"\xE2\x80\x9C", "\"", ""},
    {"\xE2\x80\x9D", "\"", ""}, {"\xE2\x80\x98", "'", ""}, {"\xE2\x80\x99", "'", ""}, {"\xE2\x88\x92", "-", ""},
    {"\xE2\x80\x93", "-", ""},
});

std::string line_range(const Block& block) {
  return block.to - block.from == 1 ? fmt::format("line {}", block.from + 1)
                                    : fmt::format("lines {} to {}", block.from + 1, block.to);
}

class Cleaner {
 public:
  explicit Cleaner(std::string_view sent) {
    while (true) {
      const std::size_t end = std::min(sent.find('\n'), sent.size());
      lines_.emplace_back(sent.substr(0, end));
      if (end == sent.size()) break;
      sent.remove_prefix(end + 1);
    }
    bool open = false;
    for (const std::string& line : lines_) {
      in_comment_.push_back(open);
      open = comment_is_open(line, open);
    }
  }

  // False: it cannot be told which block is meant.
  bool take_block(Admission& out) {
    std::vector<std::size_t> fences;
    for (std::size_t i = 0; i < lines_.size(); ++i)
      if (!in_comment_[i] && is_fence(lines_[i])) fences.push_back(i);
    if (fences.empty()) return true;
    std::vector<Block> inside, outside = {{0, fences.front()}};
    for (std::size_t i = 0; i < fences.size(); ++i) {
      const Block between{fences[i] + 1, i + 1 < fences.size() ? fences[i + 1] : lines_.size()};
      (i % 2 == 0 ? inside : outside).push_back(between);
    }
    const auto block = choose(inside, outside, out);
    if (!block) return false;
    const std::size_t before = not_blank();
    for (std::size_t i = 0; i < lines_.size(); ++i)
      if (i < block->from || i >= block->to) lines_[i].clear();
    const bool only = inside.size() == 1;
    notes_.push_back(fmt::format("the code block in {} was taken, {}; {} other lines were left out", line_range(*block),
                                 only ? "the only one" : "the only one with LITHE_LAW", before - not_blank()));
    return true;
  }

  // Prose without a fence, before the first #include (or struct) and after LITHE_LAW(...).
  void take_off_prose() {
    std::size_t begin = find([](const std::string& line) { return is_include(line); });
    if (begin == lines_.size()) begin = find([](const std::string& line) { return line.starts_with("struct "); });
    if (begin == lines_.size()) return;
    while (begin > 0 && (in_comment_[begin - 1] || is_comment(lines_[begin - 1]) || is_directive(lines_[begin - 1])))
      --begin;
    leave_out({0, begin}, "before the code");
    std::size_t end = lines_.size();
    while (end > 0 && (in_comment_[end - 1] || !has_law(lines_[end - 1]))) --end;
    if (end == 0) return;
    for (--end; end < lines_.size() && lines_[end].find(')') == std::string::npos;) ++end;
    if (end < lines_.size()) leave_out({end + 1, lines_.size()}, "after LITHE_LAW");
  }

  // An escape is C++ too (a & lt;): it stays when its word is used in any other way.
  void spell() {
    std::array<bool, kSpellings.size()> kept{};
    const std::string whole = text();
    const auto occurs = [&whole](const Spelling& each) { return whole.find(each.written) != std::string::npos; };
    if (std::ranges::none_of(kSpellings, occurs)) return;
    const Tokens tokens = tokenise(whole);
    for (std::size_t i = 0; i < tokens.list.size(); ++i) {
      const bool escape =
          i > 0 && tokens.list[i - 1].text == "&" && i + 1 < tokens.list.size() && tokens.list[i + 1].text == ";";
      if (tokens.list[i].kind != TokenKind::word || escape) continue;
      for (std::size_t k = 0; k < kSpellings.size(); ++k)
        kept[k] = kept[k] || tokens.list[i].text == kSpellings[k].word;
    }
    std::size_t escapes = 0, others = 0;
    for (std::size_t i = 0; i < lines_.size(); ++i)
      if (!in_comment_[i]) lines_[i] = spelled(lines_[i], kept, escapes, others);
    if (escapes > 0) notes_.push_back(fmt::format("HTML escapes (&lt; &gt; &amp; ...) were replaced: {}", escapes));
    if (others > 0)
      notes_.push_back(fmt::format("typographic quotes, dashes and blanks were replaced by plain ones: {}", others));
  }

  std::string text() const {
    std::string text;
    for (std::size_t i = 0; i < lines_.size(); ++i) text += (i == 0 ? "" : "\n") + lines_[i];
    return text;
  }
  const std::vector<std::string>& notes() const { return notes_; }

 private:
  std::optional<Block> choose(const std::vector<Block>& inside, const std::vector<Block>& outside,
                              Admission& out) const {
    static const std::string send = ": send the law's C++ alone";
    std::vector<Block> laws = with_law(inside);
    if (laws.empty()) laws = with_law(outside);  // only one of the two fences was copied
    if (laws.size() == 1) return laws.front();
    if (laws.size() > 1) {
      out.refuse(kTextGate,
                 fmt::format("{} code blocks have LITHE_LAW ({}), and a swap takes one law", laws.size(),
                             joined(laws, line_range)) +
                     send,
                 static_cast<int>(laws[1].from) + 1, 1);
    } else if (inside.size() == 1) {
      return inside.front();
    } else {
      out.refuse(kTextGate,
                 fmt::format("none of the {} code blocks has LITHE_LAW(Type, \"name\"), so none is a whole law",
                             inside.size()) +
                     send + std::string(kWholeLaw),
                 static_cast<int>(inside.front().from) + 1, 1);
    }
    return std::nullopt;
  }

  std::vector<Block> with_law(const std::vector<Block>& blocks) const {
    std::vector<Block> found;
    std::ranges::copy_if(blocks, std::back_inserter(found), [this](const Block& block) {
      const auto first = lines_.begin() + static_cast<std::ptrdiff_t>(block.from);
      return std::any_of(first, lines_.begin() + static_cast<std::ptrdiff_t>(block.to), has_law);
    });
    return found;
  }

  template <class Test>
  std::size_t find(Test test) const {
    std::size_t i = 0;
    while (i < lines_.size() && (in_comment_[i] || !test(lines_[i]))) ++i;
    return i;
  }

  std::size_t not_blank() const {
    return static_cast<std::size_t>(
        std::ranges::count_if(lines_, [](const std::string& line) { return !trimmed(line).empty(); }));
  }

  // Only when it is all prose: code in an odd place is for the compiler to judge.
  void leave_out(Block block, const char* where) {
    const auto is_prose = [this](std::size_t i) {
      return !in_comment_[i] && !is_comment(lines_[i]) && !is_directive(lines_[i]);
    };
    while (block.from < block.to && !is_prose(block.from)) ++block.from;
    while (block.from < block.to && !is_prose(block.to - 1)) --block.to;
    for (std::size_t i = block.from; i < block.to; ++i) {
      if (!is_prose(i) && !trimmed(lines_[i]).empty()) return;
      if (looks_like_code(lines_[i])) return;
    }
    if (block.from == block.to) return;
    for (std::size_t i = block.from; i < block.to; ++i) lines_[i].clear();
    notes_.push_back(fmt::format("{}: text {} was left out", line_range(block), where));
  }

  static std::string spelled(std::string_view line, const std::array<bool, kSpellings.size()>& kept,
                             std::size_t& escapes, std::size_t& others) {
    std::string out;
    while (!line.empty() && !line.starts_with("//")) {
      std::size_t k = 0;
      while (k < kSpellings.size() && (kept[k] || !line.starts_with(kSpellings[k].written))) ++k;
      if (k == kSpellings.size()) {
        out += line.front();
        line.remove_prefix(1);
        continue;
      }
      ++(kSpellings[k].written.front() == '&' ? escapes : others);
      out += kSpellings[k].meant;
      line.remove_prefix(kSpellings[k].written.size());
    }
    return out + std::string(line);
  }

  std::vector<std::string> lines_;
  std::vector<bool> in_comment_;  // whether the line begins inside a comment
  std::vector<std::string> notes_;
};

}  // namespace

Cleaned clean_source(std::string_view sent, Admission& out) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";  // some editors begin UTF-8 with it
  if (sent.starts_with(kByteOrderMark)) sent.remove_prefix(kByteOrderMark.size());
  if (sent.find('\0') != std::string_view::npos) return {std::string(sent), {}};  // no text at all: admission says so
  Cleaner cleaner(sent);
  if (!cleaner.take_block(out)) return {std::string(sent), {}};
  cleaner.take_off_prose();
  cleaner.spell();
  return {cleaner.text(), cleaner.notes()};
}

}  // namespace lithe::lawd
