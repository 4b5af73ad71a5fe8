// SPDX-License-Identifier: Apache-2.0
// The texts of laws beside their certificates.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "spine/core/test/full_disk_rig.hpp"
#include "supervisor/swap/certificate/certificate_files.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

class CertificateTextsTest : public testing::Test {
 protected:
  CertificateTextsTest()
      : dir_(fs::temp_directory_path() / ("lithe-texts-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())) {}
  ~CertificateTextsTest() override { fs::remove_all(dir_); }
  fs::path dir_;
};

TEST_F(CertificateTextsTest, TheTextOfALawIsBesideItsCertificateAndDisturbsNoChain) {
  CertificateFiles book(dir_);
  const std::string law = "// a law\n";
  const auto page = book.write({{"law", "pd"}}, law);
  ASSERT_TRUE(page) << page.message();
  ASSERT_TRUE(book.rewrite(*page, {{"law", "pd"}, {"verdict", "committed"}}));
  std::ifstream file(dir_ / "0001.cpp");
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), law);
  ASSERT_TRUE(book.write({{"law", "hold"}}));
  EXPECT_FALSE(fs::exists(dir_ / "0002.cpp"));
  EXPECT_TRUE(verify_chain(dir_).problems.empty());
  EXPECT_EQ(CertificateFiles(dir_).write({{"law", "pd"}})->path.filename(), "0003.json");
}

TEST_F(CertificateTextsTest, TheNewestTextsAndThoseThatAreNeededStayAndEveryCertificateDoes) {
  {
    CertificateFiles earlier(dir_, 3);
    for (int i = 0; i < 4; ++i) ASSERT_TRUE(earlier.write({{"law", "pd"}}, "// a law\n"));
  }
  CertificateFiles book(dir_, 3);
  ASSERT_TRUE(book.write({{"law", "pd"}}, "// a law\n"));
  const auto texts = [&] {
    std::string all;
    for (const char* name : {"1", "2", "3", "4", "5", "6"})
      if (fs::exists(dir_ / (std::string("000") + name + ".cpp"))) all += name;
    return all;
  };
  EXPECT_EQ(texts(), "12345") << "of this run and of the one before it";
  book.drop_old_texts({dir_ / "0001.cpp"});
  EXPECT_EQ(texts(), "1345") << "one is needed, three are new";
  ASSERT_TRUE(book.write({{"law", "pd"}}, "// a law\n"));
  book.drop_old_texts({});
  EXPECT_EQ(texts(), "456") << "no longer needed";
  EXPECT_TRUE(verify_chain(dir_).problems.empty());
  EXPECT_EQ(verify_chain(dir_).certificates, 6U);
}

TEST_F(CertificateTextsTest, ManyOldTextsAreRemovedAFewAtATime) {
  {
    CertificateFiles earlier(dir_, 100);
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(earlier.write({{"law", "pd"}}, "// a law\n"));
  }
  CertificateFiles book(dir_, 3);
  ASSERT_TRUE(book.write({{"law", "pd"}}));
  std::vector<std::size_t> texts;
  for (int i = 0; i < 4; ++i) {
    book.drop_old_texts({});
    const auto is_text = [](const auto& entry) { return entry.path().extension() == ".cpp"; };
    texts.push_back(
        static_cast<std::size_t>(std::count_if(fs::directory_iterator(dir_), fs::directory_iterator(), is_text)));
  }
  EXPECT_EQ(texts, (std::vector<std::size_t>{12, 4, 3, 3}));
  EXPECT_TRUE(fs::exists(dir_ / "0018.cpp")) << "the newest stay";
}

TEST(LawTexts, TheOldestNameGoesFirstAndNotTheFirstOfTheAlphabet) {
  LawTexts texts;
  texts.add("pd", "0001.cpp");
  texts.add("zero", "0002.cpp");
  for (int i = 1; i < 255; ++i) texts.add("law" + std::to_string(i), "old.cpp");
  texts.add("pd", "0257.cpp");
  texts.add("adaptive", "0258.cpp");
  EXPECT_EQ(texts.find("zero"), "") << "256 ran after it";
  EXPECT_EQ(texts.find("law1"), "old.cpp");
  EXPECT_EQ(texts.find("pd"), "0257.cpp") << "the newest of its name";
  EXPECT_EQ(texts.find("adaptive"), "0258.cpp");
  EXPECT_EQ(texts.all().size(), LawTexts::kMost);
}

TEST_F(CertificateTextsTest, AFullDiskForTheTextIsAnErrorToo) {
  fs::create_directories(dir_);
  const test::FullDisk full;
  CertificateFiles book(dir_);
  EXPECT_FALSE(book.write({{"law", "pd"}}, "// a law\n"));
  EXPECT_FALSE(fs::exists(dir_ / "0001.json")) << "it waits for room";
}

}  // namespace
}  // namespace lithe::control
