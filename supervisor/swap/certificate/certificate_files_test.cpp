// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/certificate/certificate_files.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <thread>
#include <utility>
#include <vector>

#include "spine/core/sha256.hpp"
#include "spine/core/test/full_disk_rig.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

class CertificateFilesTest : public testing::Test {
 protected:
  CertificateFilesTest()
      : dir_(fs::temp_directory_path() / ("lithe-record-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())) {}
  ~CertificateFilesTest() override { fs::remove_all(dir_); }
  fs::path dir_;
};

Json at(const fs::path& path) {
  std::ifstream file(path);
  return Json::parse(file, nullptr, false);
}

TEST_F(CertificateFilesTest, AnEmptyVariableIsLikeNone) {
  ::setenv("LITHE_OUT_DIR", "", 1);
  EXPECT_EQ(records_of("arm"), std::filesystem::absolute("out/arm/swaps"));
  ::setenv("LITHE_OUT_DIR", "/somewhere", 1);
  EXPECT_EQ(records_of("arm"), "/somewhere/arm/swaps");
  ::unsetenv("LITHE_OUT_DIR");
}

TEST_F(CertificateFilesTest, NumbersFilesAndGoesOnWhereAnEarlierRunStopped) {
  {
    CertificateFiles book(dir_ / "swaps");
    EXPECT_EQ(book.write({{"law", "pd"}})->path.filename(), "0001.json");
    EXPECT_EQ(book.write({{"law", "pd"}})->path.filename(), "0002.json");
  }
  CertificateFiles again(dir_ / "swaps");
  const auto page = again.write({{"law", "hold"}});
  ASSERT_TRUE(page);
  EXPECT_EQ(page->path.filename(), "0003.json");
  EXPECT_EQ(at(page->path)["law"], "hold");
}

TEST_F(CertificateFilesTest, RewritesTheRecordItHasAndUsesNoNewNumber) {
  CertificateFiles book(dir_);
  const auto page = book.write({{"verdict", "submitted"}});
  ASSERT_TRUE(page && book.rewrite(*page, {{"verdict", "committed"}}));
  EXPECT_EQ(at(page->path)["verdict"], "committed");
  EXPECT_EQ(book.write({{"verdict", "submitted"}})->path.filename(), "0002.json");
}

TEST_F(CertificateFilesTest, AFullDiskIsAnErrorAndLeavesNoFile) {
  const test::FullDisk full;
  CertificateFiles book(dir_);
  const auto page = book.write({{"law", "pd"}});
  ASSERT_FALSE(page);
  EXPECT_NE(page.message().find("over a limit"), std::string::npos) << page.message();
  EXPECT_FALSE(fs::exists(dir_ / "0001.json"));
}

TEST_F(CertificateFilesTest, AFolderThatWasRemovedIsMadeAnewWithAChainThatHolds) {
  CertificateFiles book(dir_ / "swaps");
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

TEST_F(CertificateFilesTest, AnUnusableDirectoryIsAnError) {
  fs::create_directories(dir_);
  std::ofstream(dir_ / "file") << "x";
  CertificateFiles book(dir_ / "file" / "swaps");
  EXPECT_FALSE(book.write(Json::object()));
}

// A folder that cannot be made, until its way is clear.
class LateTest : public testing::Test {
 protected:
  LateTest()
      : way_(fs::temp_directory_path() / ("lithe-late-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())),
        book_(way_ / "swaps") {
    std::ofstream(way_) << "in the way";
  }
  ~LateTest() override { fs::remove_all(way_); }
  std::string verdict(const char* file) const {
    std::ifstream stream(way_ / "swaps" / file);
    const Json certificate = Json::parse(stream, nullptr, false);
    return certificate.is_object() ? certificate.value("verdict", "") : "";
  }

  fs::path way_;
  CertificateFiles book_;
  LateCertificates late_;
};

TEST_F(LateTest, WritesTheNewestTextOnceThereIsRoomAndKeepsTheChain) {
  late_.hold(7, {{"verdict", "submitted"}});
  late_.hold(8, {{"verdict", "refused"}});
  late_.retry(book_, 1);
  EXPECT_EQ(late_.waiting(), 2U);
  late_.hold(7, {{"verdict", "committed"}});
  fs::remove(way_);
  late_.retry(book_, 2);
  EXPECT_EQ(late_.waiting(), 2U) << "not every millisecond";
  late_.retry(book_, 1 + LateCertificates::kPauseNs);
  EXPECT_EQ(late_.waiting(), 0U);
  EXPECT_EQ(verdict("0001.json"), "committed");
  EXPECT_EQ(verdict("0002.json"), "refused");
  late_.hold(7, {{"verdict", "confirmed"}});
  late_.retry(book_, 1 + 2 * LateCertificates::kPauseNs);
  EXPECT_EQ(verdict("0001.json"), "confirmed") << "the same file";
  const Chain chain = verify_chain(way_ / "swaps");
  EXPECT_TRUE(chain.problems.empty());
  EXPECT_EQ(chain.certificates, 2U);
}

TEST_F(LateTest, HoldsABoundedNumberAndTheNewestOfThem) {
  for (std::uint64_t id = 1; id <= LateCertificates::kMost + 5; ++id) late_.hold(id, {{"verdict", std::to_string(id)}});
  EXPECT_EQ(late_.waiting(), LateCertificates::kMost);
  fs::remove(way_);
  late_.retry(book_, 1);
  EXPECT_EQ(verdict("0001.json"), "6");
}

std::string text_of(const fs::path& path) {
  std::ifstream file(path);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

// Three swaps whose lives overlap, over two runs.
class ChainTest : public testing::Test {
 protected:
  ChainTest()
      : dir_(fs::temp_directory_path() / ("lithe-chain-" + std::to_string(::getpid()) + "-" +
                                          testing::UnitTest::GetInstance()->current_test_info()->name())) {
    CertificateFiles book(dir_);
    const auto first = book.write({{"law", "a"}});
    const auto second = book.write({{"law", "b"}});
    EXPECT_TRUE(book.rewrite(*first, {{"law", "a"}, {"verdict", "confirmed"}}));
    EXPECT_TRUE(book.rewrite(*second, {{"law", "b"}, {"verdict", "rolled_back"}}));
    CertificateFiles again(dir_);
    EXPECT_TRUE(again.write({{"law", "c"}}));
  }
  ~ChainTest() override { fs::remove_all(dir_); }
  void change(const std::string& name, const std::string& from, const std::string& to) {
    std::string text = text_of(dir_ / name);
    const auto where = text.find(from);
    ASSERT_NE(where, std::string::npos);
    std::ofstream(dir_ / name) << text.replace(where, from.size(), to);
  }
  // "changed 0002.json, order 0001.json"
  std::string problems() const {
    std::string all;
    for (const ChainProblem& each : verify_chain(dir_).problems)
      all += (all.empty() ? "" : ", ") + each.what + " " + each.file;
    return all;
  }
  std::vector<std::string> lines() const {
    std::istringstream text(text_of(dir_ / kChain));
    std::vector<std::string> all;
    for (std::string line; std::getline(text, line);) all.push_back(line);
    return all;
  }
  void write_lines(const std::vector<std::string>& lines) const {
    std::ofstream file(dir_ / kChain);
    for (const std::string& each : lines) file << each << '\n';
  }
  fs::path dir_;
};

TEST_F(ChainTest, HoldsOverRewritingsAndRuns) {
  const Chain chain = verify_chain(dir_);
  EXPECT_EQ(problems(), "");
  EXPECT_EQ(chain.writings, 5U);
  EXPECT_EQ(chain.certificates, 3U);
  EXPECT_EQ(chain.cut, 0U);
  EXPECT_EQ(at(dir_ / "0001.json")["previous"], "");
  EXPECT_EQ(at(dir_ / "0003.json")["previous"].get<std::string>().size(), 64U);
}

TEST_F(ChainTest, AChangedVerdictBreaksIt) {
  change("0002.json", "rolled_back", "confirmed");
  EXPECT_EQ(problems(), "changed 0002.json");
}

TEST_F(ChainTest, ACertificateThatIsGoneBreaksIt) {
  fs::remove(dir_ / "0002.json");
  EXPECT_EQ(problems(), "missing 0002.json");
}

TEST_F(ChainTest, ACertificateThatNobodyWroteBreaksIt) {
  std::ofstream(dir_ / "0009.json") << "{}\n";
  EXPECT_EQ(problems(), "extra 0009.json");
}

TEST_F(ChainTest, AnOlderVersionOfACertificateBreaksIt) {
  CertificateFiles book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  const Json as_it_began = {{"law", "b"}, {"previous", at(dir_ / "0002.json")["previous"]}};
  std::ofstream(dir_ / "0002.json") << as_it_began.dump(2) << '\n';
  EXPECT_EQ(problems(), "changed 0002.json");
}

TEST_F(ChainTest, ACertificateWhoseHashWasForgedInTheChainBreaksIt) {
  change("0001.json", "confirmed", "committed");
  std::vector<std::string> all = lines();
  Json third = Json::parse(all[2]);
  third["sha256"] = sha256_hex(text_of(dir_ / "0001.json"));
  all[2] = third.dump();
  write_lines(all);
  EXPECT_EQ(problems(), "order 0002.json") << "the line after the forged one";
}

TEST_F(ChainTest, AnyLineTakenOutBreaksIt) {
  const std::vector<std::string> all = lines();
  const char* expected[] = {"order 0002.json, order 0001.json", "order 0001.json, order 0002.json",
                            "order 0002.json, changed 0001.json", "order 0003.json, changed 0002.json",
                            "extra 0003.json"};
  for (std::size_t i = 0; i < all.size(); ++i) {
    std::vector<std::string> fewer = all;
    fewer.erase(fewer.begin() + static_cast<std::ptrdiff_t>(i));
    write_lines(fewer);
    EXPECT_EQ(problems(), expected[i]) << "without line " << i + 1;
  }
}

TEST_F(ChainTest, AnyTwoLinesThatChangePlacesBreakIt) {
  const std::vector<std::string> all = lines();
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t j = i + 1; j < all.size(); ++j) {
      std::vector<std::string> other = all;
      std::swap(other[i], other[j]);
      write_lines(other);
      EXPECT_NE(problems(), "") << i + 1 << " and " << j + 1;
    }
  }
}

TEST_F(ChainTest, AnyChangedByteOfAnyLineBreaksIt) {
  const std::string text = text_of(dir_ / kChain);
  for (std::size_t i = 0; i < text.size(); i += 7) {
    std::string other = text;
    other[i] = static_cast<char>(other[i] ^ 1);
    std::ofstream(dir_ / kChain) << other;
    EXPECT_NE(problems(), "") << "byte " << i;
  }
}

TEST_F(ChainTest, AChainThatIsGoneLeavesEveryCertificateUnproven) {
  fs::remove(dir_ / kChain);
  EXPECT_EQ(problems(), "extra 0001.json, extra 0002.json, extra 0003.json");
}

TEST_F(ChainTest, ABookThatWritesMeanwhileIsNoForger) {
  std::atomic<bool> stop{false};
  std::thread writer([&] {
    CertificateFiles book(dir_);
    for (int i = 0; i < 400 && !stop; ++i) {
      const auto page = book.write({{"turn", i}});
      EXPECT_TRUE(page && book.rewrite(*page, {{"turn", i}, {"verdict", "committed"}}));
    }
    stop = true;
  });
  std::string seen;
  while (!stop && seen.empty()) seen = problems();
  stop = true;
  writer.join();
  EXPECT_EQ(seen, "");
}

TEST_F(ChainTest, ARunThatEndsBetweenLineAndFileBreaksNothing) {
  CertificateFiles book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  fs::remove(dir_ / "0004.json");  // its line is there
  EXPECT_EQ(problems(), "");
  EXPECT_EQ(verify_chain(dir_).cut, 1U);
  CertificateFiles next(dir_);
  const auto again = next.write({{"law", "e"}});
  ASSERT_TRUE(again);
  EXPECT_EQ(problems(), "");
  const std::string old = text_of(again->path);
  ASSERT_TRUE(next.rewrite(*again, {{"law", "e"}, {"verdict", "committed"}}));
  std::ofstream(again->path) << old;
  EXPECT_EQ(problems(), "") << "the last line's file did not come";
  CertificateFiles after(dir_);
  ASSERT_TRUE(after.write({{"law", "f"}}));
  EXPECT_EQ(problems(), "");
}

TEST_F(ChainTest, ALineThatIsCutShortBreaksNothing) {
  std::ofstream(dir_ / "chain.jsonl", std::ios::app) << "{\"file\":\"00";
  CertificateFiles book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  EXPECT_EQ(problems(), "");
  EXPECT_EQ(verify_chain(dir_).cut, 1U);
}

TEST_F(ChainTest, TheNextRunDoesNotTakeAChangedNewestCertificateForItsOwn) {
  change("0003.json", "\"c\"", "\"x\"");
  EXPECT_EQ(problems(), "changed 0003.json");
  CertificateFiles book(dir_);
  ASSERT_TRUE(book.write({{"law", "d"}}));
  EXPECT_EQ(problems(), "changed 0003.json");
  change("0004.json", "\"d\"", "\"x\"");
  CertificateFiles next(dir_);
  ASSERT_TRUE(next.write({{"law", "e"}}));
  EXPECT_EQ(problems(), "changed 0003.json, changed 0004.json");
}

// The disk is full for a moment, in the middle of a line; the next writing is a rewriting.
TEST_F(ChainTest, ALineThatADiskCutIsFollowedByAWholeOne) {
  CertificateFiles book(dir_);
  const auto page = book.write({{"law", "d"}});
  ASSERT_TRUE(page);
  for (const rlim_t room : {30, 0}) {
    rlimit whole{};
    ::getrlimit(RLIMIT_FSIZE, &whole);
    rlimit full = whole;
    full.rlim_cur = fs::file_size(dir_ / kChain) + room;
    const auto before = ::signal(SIGXFSZ, SIG_IGN);
    ::setrlimit(RLIMIT_FSIZE, &full);
    EXPECT_FALSE(book.rewrite(*page, {{"law", "d"}, {"verdict", "lost"}}));
    ::setrlimit(RLIMIT_FSIZE, &whole);
    ::signal(SIGXFSZ, before);
    ASSERT_TRUE(book.rewrite(*page, {{"law", "d"}, {"verdict", "committed"}}));
    EXPECT_EQ(problems(), "");
    EXPECT_EQ(verify_chain(dir_).cut, 1U);
  }
}

TEST_F(ChainTest, AnEmptyFolderIsAnEmptyChain) {
  EXPECT_TRUE(verify_chain(dir_ / "none").problems.empty());
  EXPECT_EQ(verify_chain(dir_ / "none").writings, 0U);
}

}  // namespace
}  // namespace lithe::control
