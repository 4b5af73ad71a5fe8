// SPDX-License-Identifier: Apache-2.0
// Boot files that nobody wrote, and what must hold of each after an edit.
#pragma once

#include <algorithm>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "host/tune/boot/edit.hpp"

namespace lithe::host::random_boot {

inline const std::vector<Flag> kWanted = {{"isolcpus", "managed_irq,domain,1,3", true},
                                          {"nohz_full", "1", true},
                                          {"rcu_nocbs", "1,3", true},
                                          {"irqaffinity", "0", true},
                                          {"nosoftlockup", ""},
                                          {"nmi_watchdog", "0"},
                                          {"skew_tick", "1"}};

inline constexpr int kFiles = 1000;  // of each kind

// A boot file, and its line that may change.
struct Boot {
  std::string text;
  std::size_t meant = 0;
};

class Dice {
 public:
  explicit Dice(unsigned seed) : random_(seed) {}
  std::size_t below(std::size_t end) { return random_() % end; }
  bool once_in(std::size_t times) { return below(times) == 0; }
  template <class T>
  const T& of(const std::vector<T>& all) {
    return all[below(all.size())];
  }

 private:
  std::mt19937 random_;
};

inline const std::vector<std::string> kBlanks = {" ", " ", " ", "  ", "\t"};
inline const std::vector<std::string> kWords = {"quiet",
                                                "splash",
                                                "ro",
                                                "rw",
                                                "rootwait",
                                                "console=tty1",
                                                "root=/dev/sda",
                                                "nohz=on",
                                                "isolated=1",
                                                "rcu_nocb_poll",
                                                "usb.autosuspend=-1",
                                                "console=ttyS0,115200",
                                                "tsc_khz=1",
                                                "${cbootargs}",
                                                "init=/sbin/i",
                                                "mem-x=1",
                                                "panic=-1",
                                                "rootfstype=ext4"};

// Words of a user; some of our flags among them now and then, in a state that is no conflict.
inline std::vector<std::string> user_words(Dice& dice, bool quoted) {
  std::vector<std::string> words = {dice.of(kWords)};
  for (std::size_t i = dice.below(8); i > 0; --i) words.push_back(dice.of(kWords));
  if (quoted && dice.once_in(3)) words.push_back("dyndbg=\"file a.c +p\"");
  if (quoted && dice.once_in(5)) words.push_back("\"title=two words\"");
  const bool isolated = dice.once_in(6);
  for (const Flag& flag : kWanted)
    if (flag.isolates ? isolated : dice.once_in(6)) words.push_back(flag.text());
  std::shuffle(words.begin(), words.end(), std::minstd_rand(static_cast<unsigned>(dice.below(1000))));
  return words;
}

inline std::string joined(Dice& dice, const std::vector<std::string>& words) {
  std::string line;
  for (const std::string& word : words) line += (line.empty() ? "" : dice.of(kBlanks)) + word;
  return line;
}

inline std::string user_line(Dice& dice) {
  std::string line = joined(dice, user_words(dice, true));
  if (dice.once_in(8)) line += " -- single nosoftlockup";
  if (dice.once_in(6)) line += dice.of(kBlanks);
  return line;
}

inline Boot one_line(Dice& dice) { return {user_line(dice) + (dice.once_in(3) ? "" : "\n"), 0}; }

inline Boot extlinux(Dice& dice) {
  Boot boot{"TIMEOUT 30\n", 0};
  const std::size_t labels = 1 + dice.below(4);
  const std::size_t chosen = dice.below(labels);
  boot.text += (dice.once_in(2) ? "DEFAULT label" : "default  label") + std::to_string(chosen) + "\n";
  for (std::size_t label = 0; label < labels; ++label) {
    const std::string indent = dice.once_in(3) ? "\t" : "      ";
    std::vector<std::string> lines = {indent + "LINUX /boot/Image", indent + "MENU LABEL my append"};
    if (dice.once_in(2)) lines.push_back("# APPEND " + user_line(dice));
    if (dice.once_in(2)) lines.emplace_back();
    const std::size_t at = dice.below(lines.size() + 1);
    const std::string word = dice.once_in(4) ? "append" : "APPEND";
    lines.insert(lines.begin() + static_cast<std::ptrdiff_t>(at), indent + word + dice.of(kBlanks) + user_line(dice));
    boot.text += "LABEL label" + std::to_string(label) + "\n";
    if (label == chosen)
      boot.meant = static_cast<std::size_t>(std::count(boot.text.begin(), boot.text.end(), '\n')) + at;
    for (const std::string& line : lines) boot.text += line + "\n";
  }
  if (dice.once_in(3)) boot.text.pop_back();
  return boot;
}

inline std::vector<std::string> split_lines(const std::string& text) {
  std::vector<std::string> lines(1);
  for (const char c : text)
    if (c == '\n')
      lines.emplace_back();
    else
      lines.back() += c;
  return lines;
}

// Words for the kernel, and after "--" those for init.
inline std::pair<std::vector<std::string>, std::vector<std::string>> split_words(const std::string& line) {
  std::pair<std::vector<std::string>, std::vector<std::string>> words;
  std::string word;
  bool quoted = false;
  bool to_init = false;
  for (const char c : line + " ") {
    if (c == '"') quoted = !quoted;
    if (quoted || (c != ' ' && c != '\t')) {
      word += c;
      continue;
    }
    if (!word.empty()) (to_init ? words.second : words.first).push_back(word);
    to_init = to_init || word == "--";
    word.clear();
  }
  return words;
}

// What is wrong with the words of a line after an edit; empty: nothing.
inline std::string wrong_words(const std::string& before, const std::string& after) {
  const auto [had, init_had] = split_words(before);
  auto [has, init_has] = split_words(after);
  for (const Flag& flag : kWanted) {
    const auto count = std::count(has.begin(), has.end(), flag.text());
    if (count != 1) return flag.text() + " stands " + std::to_string(count) + " times";
    const bool users = std::find(had.begin(), had.end(), flag.text()) != had.end();
    if (!users) has.erase(std::find(has.begin(), has.end(), flag.text()));
  }
  if (has != had) return "the user's words are others, or in another order";
  return init_has == init_had ? "" : "the words for init are others";
}

// What is wrong with an edit of a file in which one line may change; empty: nothing.
inline std::string violation(const Boot& boot, const std::string& after) {
  const std::vector<std::string> old_lines = split_lines(boot.text);
  const std::vector<std::string> new_lines = split_lines(after);
  if (old_lines.size() != new_lines.size()) return "another number of lines";
  for (std::size_t i = 0; i < old_lines.size(); ++i)
    if (i != boot.meant && old_lines[i] != new_lines[i]) return "line " + std::to_string(i + 1) + " changed";
  const std::string& old_line = old_lines[boot.meant];
  const std::string& new_line = new_lines[boot.meant];
  const auto differ = std::mismatch(old_line.begin(), old_line.end(), new_line.begin(), new_line.end()).first;
  if (!std::string_view(new_line).ends_with(std::string(differ, old_line.end()))) return "more than one place changed";
  return wrong_words(old_line, new_line);
}

}  // namespace lithe::host::random_boot
