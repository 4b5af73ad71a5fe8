// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/record.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

namespace lithe::swap {
namespace {

namespace fs = std::filesystem;

class RecordTest : public testing::Test {
 protected:
  RecordTest()
      : dir_(fs::temp_directory_path() / ("lithe-record-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())) {}
  ~RecordTest() override { fs::remove_all(dir_); }
  fs::path dir_;
};

Json at(const fs::path& path) {
  std::ifstream file(path);
  return Json::parse(file, nullptr, false);
}

std::string text_of(const fs::path& path) {
  std::ifstream file(path);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

TEST_F(RecordTest, NumbersFilesAndGoesOnWhereAnEarlierRunStopped) {
  {
    RecordBook book(dir_ / "swaps");
    EXPECT_EQ(book.write({{"law", "pd"}})->path.filename(), "0001.json");
    EXPECT_EQ(book.write({{"law", "pd"}})->path.filename(), "0002.json");
  }
  RecordBook again(dir_ / "swaps");
  const auto page = again.write({{"law", "hold"}});
  ASSERT_TRUE(page);
  EXPECT_EQ(page->path.filename(), "0003.json");
  EXPECT_EQ(at(page->path)["law"], "hold");
}

TEST_F(RecordTest, RewritesTheRecordItHasAndUsesNoNewNumber) {
  RecordBook book(dir_);
  const auto page = book.write({{"verdict", "submitted"}});
  ASSERT_TRUE(page && book.rewrite(*page, {{"verdict", "committed"}}));
  EXPECT_EQ(at(page->path)["verdict"], "committed");
  EXPECT_EQ(book.write({{"verdict", "submitted"}})->path.filename(), "0002.json");
}

TEST_F(RecordTest, AFullDiskIsAnErrorAndLeavesNoFile) {
  fs::create_directories(dir_);
  fs::create_symlink("/dev/full", dir_ / "0001.json.draft");
  RecordBook book(dir_);
  const auto page = book.write({{"law", "pd"}});
  ASSERT_FALSE(page);
  EXPECT_NE(page.message().find("disk full"), std::string::npos);
  EXPECT_FALSE(fs::exists(dir_ / "0001.json"));
}

TEST_F(RecordTest, AnUnusableDirectoryIsAnError) {
  fs::create_directories(dir_);
  std::ofstream(dir_ / "file") << "x";
  RecordBook book(dir_ / "file" / "swaps");
  EXPECT_FALSE(book.write(Json::object()));
}

// Three swaps whose lives overlap, over two runs.
class ChainTest : public RecordTest {
 protected:
  ChainTest() {
    RecordBook book(dir_);
    const auto first = book.write({{"law", "a"}});
    const auto second = book.write({{"law", "b"}});
    EXPECT_TRUE(book.rewrite(*first, {{"law", "a"}, {"verdict", "confirmed"}}));
    EXPECT_TRUE(book.rewrite(*second, {{"law", "b"}, {"verdict", "rolled_back"}}));
    RecordBook again(dir_);
    EXPECT_TRUE(again.write({{"law", "c"}}));
  }
  void change(const std::string& name, const std::string& from, const std::string& to) {
    std::string text = text_of(dir_ / name);
    const auto where = text.find(from);
    ASSERT_NE(where, std::string::npos);
    std::ofstream(dir_ / name) << text.replace(where, from.size(), to);
  }
  std::size_t problems() const { return verify_chain(dir_).problems.size(); }
};

TEST_F(ChainTest, HoldsOverRewritingsAndRuns) {
  const Chain chain = verify_chain(dir_);
  EXPECT_EQ(chain.problems, std::vector<std::string>{});
  EXPECT_EQ(chain.writings, 5U);
  EXPECT_EQ(chain.certificates, 3U);
  EXPECT_EQ(chain.cut, 0U);
  EXPECT_EQ(at(dir_ / "0001.json")["previous"], "");
  EXPECT_EQ(at(dir_ / "0003.json")["previous"].get<std::string>().size(), 64U);
}

TEST_F(ChainTest, AChangedVerdictBreaksIt) {
  change("0002.json", "rolled_back", "confirmed");
  EXPECT_EQ(problems(), 1U);
}

TEST_F(ChainTest, ACertificateThatIsGoneBreaksIt) {
  fs::remove(dir_ / "0002.json");
  EXPECT_EQ(problems(), 1U);
}

TEST_F(ChainTest, ACertificateThatNobodyWroteBreaksIt) {
  std::ofstream(dir_ / "0009.json") << "{}\n";
  EXPECT_EQ(problems(), 1U);
}

TEST_F(ChainTest, AChangedLineBreaksIt) {
  change("chain.jsonl", "0002.json", "0003.json");
  EXPECT_GE(problems(), 1U);
}

TEST_F(ChainTest, ALineTakenOutBreaksIt) {
  const std::string text = text_of(dir_ / "chain.jsonl");
  std::ofstream(dir_ / "chain.jsonl") << text.substr(text.find('\n') + 1);
  EXPECT_GE(problems(), 1U);
}

TEST_F(ChainTest, ARunThatEndsBetweenLineAndFileBreaksNothing) {
  const std::string before = text_of(dir_ / "0003.json");
  RecordBook book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  fs::remove(dir_ / "0004.json");  // its line is there
  EXPECT_EQ(problems(), 0U);
  EXPECT_EQ(verify_chain(dir_).cut, 1U);
  RecordBook next(dir_);
  const auto again = next.write({{"law", "e"}});
  ASSERT_TRUE(again);
  EXPECT_EQ(problems(), 0U);
  const std::string old = text_of(again->path);
  ASSERT_TRUE(next.rewrite(*again, {{"law", "e"}, {"verdict", "committed"}}));
  std::ofstream(again->path) << old;
  EXPECT_EQ(problems(), 0U) << "the last line's file did not come";
  RecordBook after(dir_);
  ASSERT_TRUE(after.write({{"law", "f"}}));
  EXPECT_EQ(verify_chain(dir_).problems, std::vector<std::string>{});
}

TEST_F(ChainTest, ALineThatIsCutShortBreaksNothing) {
  std::ofstream(dir_ / "chain.jsonl", std::ios::app) << "{\"file\":\"00";
  RecordBook book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  EXPECT_EQ(verify_chain(dir_).problems, std::vector<std::string>{});
  EXPECT_EQ(verify_chain(dir_).cut, 1U);
}

TEST_F(RecordTest, AnEmptyFolderIsAnEmptyChain) {
  EXPECT_TRUE(verify_chain(dir_).problems.empty());
  EXPECT_EQ(verify_chain(dir_).writings, 0U);
}

}  // namespace
}  // namespace lithe::swap
