// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/edit.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "host/test/root_rig.hpp"
#include "host/tune/boot/test/random_boot_rig.hpp"

namespace lithe::host {
namespace {

using random_boot::Dice;
using random_boot::kFiles;
using random_boot::kWanted;

constexpr const char* kMain = "/etc/default/grub";

// A user's words as a person may write them in shell.
std::string in_shell(Dice& dice, const std::string& words) {
  std::string text;
  switch (dice.below(3)) {
    case 0:
      return "'" + words + "'";
    case 1:
      for (const char c : words) text += (c == '"' || c == '$' || c == '\\' ? "\\" : "") + std::string(1, c);
      return "\"" + text + "\"";
    default:
      for (const char c : words)
        text += (c == ' ' || c == '"' || c == '$' || c == '\t' ? "\\" : "") + std::string(1, c);
      return text;
  }
}

const std::vector<std::string> kOtherLines = {"# don't read \"this as a quote",
                                              "",
                                              "GRUB_DEFAULT=0",
                                              "GRUB_TIMEOUT=5  # it's a comment",
                                              "GRUB_DISTRIBUTOR=`echo Debian`",
                                              "  # spaces in front",
                                              "if true; then echo 'a b' >/dev/null; fi",
                                              "GRUB_INIT_TUNE=\"480 440 1\"",
                                              "export GRUB_TERMINAL=console",
                                              "#GRUB_CMDLINE_LINUX=\"isolcpus=9"};

struct Tree {
  std::vector<GrubFile> files;
  bool has_folder = false;
};

// The words of one user, over the variables and files in which they may stand.
Tree generated(Dice& dice) {
  Tree tree;
  tree.has_folder = dice.once_in(2);
  std::vector<std::string> words = random_boot::user_words(dice, true);
  const std::size_t half = dice.below(words.size() + 1);
  const std::vector<std::string> first(words.begin(), words.begin() + static_cast<std::ptrdiff_t>(half));
  const std::vector<std::string> second(words.begin() + static_cast<std::ptrdiff_t>(half), words.end());
  std::vector<std::string> lines = {
      (dice.once_in(4) ? "export " : "") + std::string("GRUB_CMDLINE_LINUX=") +
          in_shell(dice, random_boot::joined(dice, first)),
  };
  const std::string other = "GRUB_CMDLINE_LINUX_DEFAULT=" + in_shell(dice, random_boot::joined(dice, second));
  const bool apart = tree.has_folder && dice.once_in(2);
  if (!apart) lines.push_back(other + (dice.once_in(3) ? " # why not" : ""));
  for (std::size_t i = dice.below(5); i > 0; --i)
    lines.insert(lines.begin() + static_cast<std::ptrdiff_t>(dice.below(lines.size() + 1)), dice.of(kOtherLines));
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  if (dice.once_in(3) && !lines.back().empty()) text.pop_back();
  tree.files.push_back({kMain, text});
  if (apart)
    tree.files.push_back({"/etc/default/grub.d/" + std::string(dice.once_in(2) ? "50-own.cfg" : "zz.cfg"), other});
  return tree;
}

// The tree with the edit made.
Tree edited(Tree tree, const Edit& edit) {
  const auto file =
      std::find_if(tree.files.begin(), tree.files.end(), [&](const GrubFile& f) { return f.path >= edit.path; });
  if (file != tree.files.end() && file->path == edit.path)
    file->text = edit.after;
  else
    tree.files.insert(file, {edit.path, edit.after});
  return tree;
}

// Shell that reads the files of a tree one after another, as update-grub does, and prints both variables.
std::string script_of(const Tree& tree) {
  std::string script = "(\n";
  for (const GrubFile& file : tree.files) script += file.text + "\n";
  return script + "printf '%s\\n%s\\n' \"$GRUB_CMDLINE_LINUX\" \"$GRUB_CMDLINE_LINUX_DEFAULT\"\n)\n";
}

std::vector<std::array<std::string, 2>> run_scripts(const std::string& scripts) {
  const FakeRoot root;
  root.write("/scripts", scripts);
  EXPECT_EQ(std::system(("cd '" + root.path() + "' && sh scripts >values").c_str()), 0);
  std::vector<std::array<std::string, 2>> all(kFiles);
  std::ifstream values(root.path() + "/values");
  for (auto& [linux_words, default_words] : all)
    EXPECT_TRUE(std::getline(values, linux_words) && std::getline(values, default_words));
  return all;
}

// What a shell finds wrong with edits of all trees, each with its number.
std::vector<std::string> violations(const std::function<Tree(const Tree&)>& edit) {
  std::string before, after;
  for (int i = 0; i < kFiles; ++i) {
    Dice dice(static_cast<unsigned>(i));
    const Tree tree = generated(dice);
    before += script_of(tree);
    after += script_of(edit(tree));
  }
  const auto had = run_scripts(before);
  const auto has = run_scripts(after);
  std::vector<std::string> found;
  for (std::size_t i = 0; i < had.size(); ++i) {
    std::string wrong = has[i][0].starts_with(had[i][0]) ? "" : "the user's words are gone";
    if (has[i][1] != had[i][1]) wrong = "the variable for the normal entry changed";
    if (wrong.empty()) wrong = random_boot::wrong_words(had[i][1] + " " + had[i][0], has[i][1] + " " + has[i][0]);
    if (!wrong.empty()) found.push_back(std::to_string(i) + ": " + wrong + ": " + has[i][0]);
  }
  return found;
}

TEST(EditGrub, AShellReadsTheUsersWordsAndEachFlagOnce) {
  EXPECT_EQ(violations([](const Tree& tree) {
              const Result<Edit> edit = edit_grub(tree.files, tree.has_folder, kWanted);
              EXPECT_TRUE(edit) << edit.message() << "\n" << tree.files[0].text;
              EXPECT_TRUE(edit->after.starts_with(edit->before)) << edit->after;  // no line of the user changes
              const Tree changed = edited(tree, *edit);
              const Result<Edit> again = edit_grub(changed.files, tree.has_folder, kWanted);
              EXPECT_TRUE(again && again->before == again->after) << changed.files[0].text;
              return changed;
            }),
            std::vector<std::string>{});
}

TEST(EditGrub, ATwinThatDropsTheUsersWordsIsCaught) {
  const auto twin = [](const Tree& tree) {
    Edit edit = *edit_grub(tree.files, tree.has_folder, kWanted);
    const std::size_t old_value = edit.after.rfind("$GRUB_CMDLINE_LINUX ");
    if (edit.after != edit.before) edit.after.erase(old_value, std::string("$GRUB_CMDLINE_LINUX ").size());
    return edited(tree, edit);
  };
  EXPECT_GT(violations(twin).size(), 500U);
}

std::string broken(Dice& dice, const Tree& tree, const Edit& edit) {
  const std::string& text = tree.files[0].text;
  const std::string end = text.ends_with('\n') ? "" : "\n";
  const bool ours = edit.after != edit.before && edit.path == kMain;
  switch (dice.below(ours ? 7 : 5)) {
    case 0:
      return std::string(text).insert(dice.below(text.size() + 1), 1, dice.once_in(2) ? '\0' : '\xff');
    case 1:
      return std::string(text).insert(dice.below(text.size() + 1), "\r");
    case 2:
      return text + end + (dice.once_in(2) ? "GRUB_CMDLINE_LINUX=\"quiet\n" : "GRUB_CMDLINE_LINUX=quiet\\\n");
    case 3:
      return text + end + "GRUB_CMDLINE_LINUX=\"$GRUB_CMDLINE_LINUX skew_tick=0\"\n";
    case 4:
      return "";
    case 5: {  // as after a full disk: at least the last line of ours is not whole
      const std::size_t begin = edit.before.size() + 13;  // "\n# lithe tune"
      return edit.after.substr(0, begin + dice.below(edit.after.size() - 1 - begin));
    }
    default: {
      const std::size_t last = edit.after.rfind("\"\n");
      return std::string(edit.after).insert(last, " quiet");
    }
  }
}

TEST(EditGrub, EveryBrokenFileIsRefused) {
  for (int i = 0; i < kFiles; ++i) {
    Dice dice(static_cast<unsigned>(i));
    Tree tree = generated(dice);
    const Result<Edit> edit = edit_grub(tree.files, tree.has_folder, kWanted);
    ASSERT_TRUE(edit);
    tree.files[0].text = broken(dice, tree, *edit);
    const Result<Edit> again = edit_grub(tree.files, tree.has_folder, kWanted);
    ASSERT_FALSE(again) << "seed " << i << "\n" << tree.files[0].text;
    ASSERT_TRUE(again.message().starts_with("/etc/default/grub")) << again.message();
  }
}

TEST(EditGrub, ReadsLinesAsAShellDoes) {
  const auto value = [](const std::string& line) {
    const ShellLine read = read_shell_line(line);
    return read.variable + "|" + read.value + (read.is_whole ? "" : "|open");
  };
  EXPECT_EQ(value("A=b c"), "A|b");
  EXPECT_EQ(value("  export A='b  c'd # e"), "A|b  cd");
  EXPECT_EQ(value("A=\"b \\\"c\\\" \\d\""), "A|b \"c\" \\d");
  EXPECT_EQ(value("A=b\\ c"), "A|b c");
  EXPECT_EQ(value("A=b#c"), "A|b#c");
  EXPECT_EQ(value("# A='b"), "|");
  EXPECT_EQ(value("echo \"a\" # don't"), "|");
  EXPECT_EQ(value("A=\"b"), "A|b|open");
  EXPECT_EQ(value("A=b\\"), "A|b|open");
  EXPECT_EQ(value("[ \"$A\" = 'x ] && B=1"), "||open");
}

}  // namespace
}  // namespace lithe::host
