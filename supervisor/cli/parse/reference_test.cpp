// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>
#include <stdlib.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>

#include "supervisor/cli/parse/words.hpp"

namespace lithe::cli {
namespace {

class ReferenceTest : public ::testing::Test {
 protected:
  void SetUp() override { add_words(app_, words_); }
  std::string help(const std::string& form) {
    const auto text = help_text(app_, {}, form);
    return std::holds_alternative<std::string>(text) ? std::get<std::string>(text) : "";
  }
  std::string hint(const std::vector<std::string>& words) {
    const auto wrong = wrong_verb(app_, words);
    return wrong ? wrong->message : "";
  }

  CommandLine words_;
  CLI::App app_;
};

// What a shell says of a script that it only reads.
int read_by(const std::string& shell, const std::string& script) {
  char name[] = "/tmp/lithe_completion_XXXXXX";
  const int fd = mkstemp(name);
  if (fd < 0) return -1;
  std::ofstream(name) << script;
  const int status = std::system((shell + " -n " + name).c_str());
  std::filesystem::remove(name);
  return status;
}

TEST_F(ReferenceTest, AWrongVerbIsNamedWithTheNearestRightOne) {
  EXPECT_EQ(hint({"stauts"}), "lithe has no verb 'stauts'; did you mean 'status'?");
  EXPECT_EQ(hint({"--json", "--robot", "arm", "armm"}), "lithe has no verb 'armm'; did you mean 'arm'?");
  EXPECT_EQ(hint({"law", "chek", "x.cpp"}), "lithe law has no verb 'chek'; did you mean 'check'?");
  EXPECT_EQ(hint({"--nosuch", "status"}), "lithe has no option '--nosuch' before its verb");
  EXPECT_NE(hint({"xyzzyxyzzy"}).find("; one of: run, "), std::string::npos) << hint({"xyzzyxyzzy"});
}

TEST_F(ReferenceTest, AWrongOptionIsNamedWithTheNearestRightOne) {
  EXPECT_EQ(hint({"swap", "law.cpp", "--shadw=2"}), "lithe swap has no option '--shadw'; did you mean '--shadow'?");
  EXPECT_NE(hint({"jog", "--5"}).find("lithe jog has no option '--5'"), std::string::npos);
  EXPECT_EQ(hint({"swap", "law.cpp", "--shadow=2", "--json", "--help"}), "");
  EXPECT_EQ(hint({"move", "elbow", "-5"}), "") << "a number";
  EXPECT_EQ(hint({"agent", "--of-the-program"}), "") << "the words of another program";
}

TEST_F(ReferenceTest, WhatIsNoVerbIsLeftAlone) {
  EXPECT_EQ(hint({"status"}), "");
  EXPECT_EQ(hint({"--robot", "stauts", "status"}), "");
  EXPECT_EQ(hint({"swap", "stauts"}), "");
  EXPECT_EQ(hint({"sim", "stauts"}), "");
  EXPECT_EQ(hint({"--help"}), "");
  EXPECT_EQ(hint({}), "");
}

TEST_F(ReferenceTest, EveryVerbSaysWhatItDoesUnderAHeading) {
  for (const Verb& each : all_verbs(app_)) {
    EXPECT_FALSE(each.app->get_description().empty()) << each.name;
    if (each.name.find(' ') == std::string::npos) EXPECT_NE(each.app->get_group(), "Subcommands") << each.name;
    for (const Argument& argument : arguments_of(*each.app)) EXPECT_FALSE(argument.about.empty()) << argument.words;
  }
}

TEST_F(ReferenceTest, EveryFormNamesEveryVerb) {
  for (const char* form : {"", "markdown", "man", "bash", "zsh"}) {
    const std::string text = help(form);
    for (const Verb& each : all_verbs(app_)) {
      const bool nested = each.name.find(' ') != std::string::npos;
      if (nested && *form == '\0') continue;  // one level at a time
      EXPECT_NE(text.find(each.name), std::string::npos) << form << ": " << each.name;
    }
  }
}

TEST_F(ReferenceTest, ThePageInTheDocumentationIsTheOneThatIsMade) {
  std::ifstream file(LITHE_CLI_PAGE);
  const std::string page(std::istreambuf_iterator<char>(file), {});
  EXPECT_EQ(page, help("markdown")) << "next: build/release/bin/lithe help --markdown > docs/reference/cli.md";
}

TEST_F(ReferenceTest, BashReadsItsCompletion) {
  EXPECT_EQ(read_by("bash", help("bash")), 0) << help("bash");
  EXPECT_NE(read_by("bash", "case x in"), 0) << "it would say so";
}

TEST_F(ReferenceTest, ZshReadsItsCompletion) {
  if (std::system("command -v zsh > /dev/null") != 0) GTEST_SKIP() << "no zsh here";
  EXPECT_EQ(read_by("zsh", help("zsh")), 0) << help("zsh");
}

TEST_F(ReferenceTest, AManualPageHasNoLineThatTroffWouldTakeForACommand) {
  std::istringstream text(help("man"));
  for (std::string line; std::getline(text, line);) {
    if (!line.starts_with(".")) continue;
    const std::string command = line.substr(0, line.find(' '));
    EXPECT_TRUE(command == ".TH" || command == ".SH" || command == ".SS" || command == ".TP" || command == ".B" ||
                command == ".RS" || command == ".RE")
        << line;
  }
}

TEST_F(ReferenceTest, TheVersionNamesTheLayoutThatProgramsMustShare) {
  EXPECT_TRUE(version_text().starts_with("lithe ")) << version_text();
  EXPECT_NE(version_text().find("layout "), std::string::npos);
}

}  // namespace
}  // namespace lithe::cli
