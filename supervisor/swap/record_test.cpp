// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/record.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "supervisor/swap/chain.hpp"

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

TEST_F(RecordTest, AFolderThatWasRemovedIsMadeAnewWithAChainThatHolds) {
  RecordBook book(dir_ / "swaps");
  const auto first = book.write({{"law", "pd"}});
  const auto second = book.write({{"law", "hold"}});
  ASSERT_TRUE(first && second);
  EXPECT_EQ(book.begun_anew(), "");
  fs::remove_all(dir_);
  ASSERT_TRUE(book.rewrite(*second, {{"law", "hold"}, {"verdict", "confirmed"}}));
  const auto third = book.write({{"law", "lqr"}});
  ASSERT_TRUE(third) << third.message();
  EXPECT_EQ(third->path.filename(), "0003.json") << "no number is given twice";
  ASSERT_TRUE(book.rewrite(*first, {{"law", "pd"}, {"verdict", "rolled_back"}}));
  ASSERT_TRUE(book.rewrite(*third, {{"law", "lqr"}, {"verdict", "confirmed"}}));
  const Chain chain = verify_chain(dir_ / "swaps");
  EXPECT_TRUE(chain.problems.empty()) << chain.to_json().dump(2);
  EXPECT_EQ(chain.certificates, 3u);
  EXPECT_NE(book.begun_anew().find("was removed"), std::string::npos);
}

TEST_F(RecordTest, AnUnusableDirectoryIsAnError) {
  fs::create_directories(dir_);
  std::ofstream(dir_ / "file") << "x";
  RecordBook book(dir_ / "file" / "swaps");
  EXPECT_FALSE(book.write(Json::object()));
}

}  // namespace
}  // namespace lithe::swap
