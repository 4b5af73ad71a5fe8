// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/board.hpp"

#include <gtest/gtest.h>

#include <string>

#include "host/test/root_rig.hpp"

namespace lithe::host {
namespace {

constexpr const char* kSmall =
    "title = \"A\"\nsources = [\"https://a.org\"]\n[detect]\nfile = [\"/a\"]\n[[boot]]\npath = \"/b\"\nformat = "
    "\"line\"\n";

std::string mistake(const std::string& text) {
  const Result<Board> board = parse_board(text, "own.toml");
  return board ? "" : board.message();
}

TEST(Boards, OfTheHouseAreWholeAndHaveSources) {
  const Result<std::vector<Board>> boards = load_boards(boards_folder());
  ASSERT_TRUE(boards) << boards.message();
  std::vector<std::string> names;
  for (const Board& board : *boards) {
    names.push_back(board.name);
    EXPECT_FALSE(board.models.empty() && board.files.empty() && board.cpu_flag.empty()) << board.name;
    EXPECT_FALSE(board.boot.empty()) << board.name;
    EXPECT_GE(board.sources.size(), 2U) << board.name;
    for (const std::string& source : board.sources) EXPECT_TRUE(source.starts_with("https://")) << source;
    for (const BootFile& boot : board.boot) EXPECT_TRUE(boot.path.starts_with("/")) << boot.path;
  }
  EXPECT_EQ(names, (std::vector<std::string>{"jetson_orin", "pi4", "pi5", "vm", "x86"}));
}

TEST(Boards, AreFoundByModelBeforeAnythingElse) {
  const Result<std::vector<Board>> boards = load_boards(boards_folder());
  ASSERT_TRUE(boards) << boards.message();
  const auto found = [&](const std::string& model) {
    const FakeRoot root;
    root.write("/proc/device-tree/model", model + '\0');
    root.write("/etc/default/grub", "");
    const FoundBoard board = find_board(HostFiles(root.path()), *boards);
    return board.board == nullptr ? "" : board.board->name;
  };
  EXPECT_EQ(found("Raspberry Pi 4 Model B Rev 1.4"), "pi4");
  EXPECT_EQ(found("Raspberry Pi 400 Rev 1.0"), "pi4");
  EXPECT_EQ(found("Raspberry Pi Compute Module 5 Rev 1.0"), "pi5");
  EXPECT_EQ(found("NVIDIA Jetson AGX Orin Developer Kit"), "jetson_orin");
  EXPECT_EQ(found("linux,dummy-virt"), "vm");
  EXPECT_EQ(found("Ampere Altra"), "x86");  // by /etc/default/grub
}

TEST(Boards, AWrongProfileIsToldWithItsLine) {
  EXPECT_EQ(mistake(kSmall), "");
  EXPECT_NE(mistake(std::string(kSmall) + "colour = 1\n").find("own.toml:8:1: 'colour' is no key in [[boot]]"),
            std::string::npos);
  EXPECT_NE(
      mistake("title = 3\nsources = \"x\"\n").find("own.toml:2:11: sources: this is a string; give a list of strings"),
      std::string::npos)
      << mistake("title = 3\nsources = \"x\"\n");
  EXPECT_NE(mistake("title = ").find("not TOML"), std::string::npos);
  EXPECT_NE(mistake("title = \"A\"\nsources = [1]\n").find("sources"), std::string::npos);
}

TEST(Boards, AnEmptyFolderIsAnError) {
  const FakeRoot root;
  EXPECT_FALSE(load_boards(root.path()));
}

}  // namespace
}  // namespace lithe::host
