// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/edit.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "host/tune/boot/test/random_boot_rig.hpp"

namespace lithe::host {
namespace {

using random_boot::Boot;
using random_boot::Dice;
using random_boot::kFiles;
using random_boot::kWanted;

using Editor = std::function<Result<Edit>(const std::string& text)>;
const Editor kLine = [](const std::string& text) { return edit_line("/boot/cmdline.txt", text, kWanted); };
const Editor kExtlinux = [](const std::string& text) { return edit_extlinux("/extlinux.conf", text, kWanted); };

// Every file is edited as meant, and a second edit finds nothing to do.
void expect_edits(Boot (*make)(Dice&), const Editor& editor) {
  for (int seed = 0; seed < kFiles; ++seed) {
    Dice dice(static_cast<unsigned>(seed));
    const Boot boot = make(dice);
    const Result<Edit> edit = editor(boot.text);
    ASSERT_TRUE(edit) << edit.message() << "\n" << boot.text;
    ASSERT_EQ(edit->before, boot.text);
    ASSERT_EQ(random_boot::violation(boot, edit->after), "") << "seed " << seed << "\n" << boot.text << edit->after;
    const Result<Edit> again = editor(edit->after);
    ASSERT_TRUE(again) << again.message();
    ASSERT_EQ(again->after, edit->after);
  }
}

// How many of the files a faulty editor spoils, as the property sees it.
int caught(Boot (*make)(Dice&), const std::function<std::string(const std::string&)>& twin) {
  int count = 0;
  for (int seed = 0; seed < kFiles; ++seed) {
    Dice dice(static_cast<unsigned>(seed));
    const Boot boot = make(dice);
    if (!random_boot::violation(boot, twin(boot.text)).empty()) ++count;
  }
  return count;
}

TEST(EditLine, EveryFileKeepsItsWordsAndGetsEachFlagOnce) { expect_edits(random_boot::one_line, kLine); }

TEST(EditExtlinux, EveryFileChangesInItsDefaultLabelAlone) { expect_edits(random_boot::extlinux, kExtlinux); }

TEST(EditLine, ATwinThatAppendsBlindlyIsCaught) {
  const auto twin = [](std::string text) {
    return text.insert(std::min(text.find('\n'), text.size()), " " + text_of(kWanted));
  };
  const int spoilt = caught(random_boot::one_line, twin);
  EXPECT_GT(spoilt, 300);
  EXPECT_LT(spoilt, kFiles);  // where nothing stood before, it does the same
}

TEST(EditExtlinux, ATwinThatAppendsToAllLabelsIsCaught) {
  const auto twin = [](const std::string& text) {
    std::string after;
    for (const std::string& line : random_boot::split_lines(text)) {
      const std::size_t first = line.find_first_not_of(" \t");
      const std::string word = first == std::string::npos ? "" : line.substr(first, 6);
      const bool append = word == "APPEND" || word == "append";
      const Result<std::string> changed = append ? with_flags(line, kWanted, "") : Result<std::string>(line);
      after += (changed ? *changed : line) + "\n";
    }
    after.pop_back();
    return after;
  };
  const int spoilt = caught(random_boot::extlinux, twin);
  EXPECT_GT(spoilt, 500);     // with one label there is nothing to spoil
  EXPECT_LT(spoilt, kFiles);  // so the twin differs from the editor in this rule alone
}

// Half of our flags: cut within those that isolate, as a person or a full disk leaves it.
std::string half_written(Dice& dice, const std::string& edited) {
  const std::size_t begin = edited.find("isolcpus=") + 9;
  const std::size_t end = edited.find("irqaffinity=0") + 13;
  const std::size_t cut = begin + dice.below(end - begin);
  return edited.substr(0, cut) + edited.substr(std::min(edited.find('\n', cut), edited.size()));
}

std::string with_byte(Dice& dice, std::string text, char byte) {
  return text.insert(dice.below(text.size() + 1), 1, byte);
}

// Where the words for the kernel begin, behind APPEND.
std::size_t first_word(const std::string& line) {
  const std::size_t first = line.find_first_not_of(" \t");
  const bool behind = line.compare(first, 6, "APPEND") == 0 || line.compare(first, 6, "append") == 0;
  return behind ? line.find_first_not_of(" \t", first + 6) : first;
}

// One of the ways in which any boot file can be broken.
std::string broken(Dice& dice, const Boot& boot, const std::string& edited) {
  std::vector<std::string> lines = random_boot::split_lines(boot.text);
  std::string& line = lines[boot.meant];
  const bool isolated = boot.text.find("isolcpus=") != std::string::npos;
  switch (dice.below(isolated ? 6 : 8)) {
    case 0:
      return with_byte(dice, boot.text, '\0');
    case 1:
      return with_byte(dice, boot.text, '\xff');
    case 2:
      return with_byte(dice, boot.text, '\r');
    case 3:
      return dice.once_in(2) ? "" : "\n \n";
    case 4:
      line.insert(first_word(line), "\"");
      break;
    case 5:
      line.insert(first_word(line), "nmi-watchdog=1 ");
      break;
    case 6:
      line.insert(first_word(line), "isolcpus=1,3 ");
      break;
    default:
      return half_written(dice, edited);
  }
  std::string text;
  for (const std::string& each : lines) text += each + "\n";
  text.pop_back();
  return text;
}

void expect_refusals(Boot (*make)(Dice&), const Editor& editor) {
  for (int seed = 0; seed < kFiles; ++seed) {
    Dice dice(static_cast<unsigned>(seed));
    const Boot boot = make(dice);
    const std::string text = broken(dice, boot, editor(boot.text)->after);
    const Result<Edit> edit = editor(text);
    ASSERT_FALSE(edit) << "seed " << seed << "\n" << text << "\n" << edit->after;
    ASSERT_TRUE(edit.message().starts_with("/")) << edit.message();  // it names the file
  }
}

TEST(EditLine, EveryBrokenFileIsRefused) { expect_refusals(random_boot::one_line, kLine); }

TEST(EditExtlinux, EveryBrokenFileIsRefused) { expect_refusals(random_boot::extlinux, kExtlinux); }

std::string why(const Editor& editor, const std::string& text) {
  const Result<Edit> edit = editor(text);
  return edit ? "" : edit.message().substr(0, edit.message().find(": nothing is written"));
}

TEST(EditLine, SaysWhatIsWrongAndWhere) {
  EXPECT_EQ(why(kLine, ""), "/boot/cmdline.txt: the file is empty");
  EXPECT_EQ(why(kLine, "quiet\r\n"), "/boot/cmdline.txt:1: a line end of Windows (CR)");
  EXPECT_EQ(why(kLine, std::string("ro \0", 4)), "/boot/cmdline.txt:1: byte 0x00 is no text");
  EXPECT_EQ(why(kLine, "quiet\nro\n"), "/boot/cmdline.txt:2: a second line, and this file has exactly one");
  EXPECT_EQ(why(kLine, "quiet\n\n"), "/boot/cmdline.txt:2: a second line, and this file has exactly one");
  EXPECT_EQ(why(kLine, "ro a=\"b c\n"),
            "/boot/cmdline.txt:1: a double quote opens at column 4 or later and does not close");
  EXPECT_EQ(why(kLine, "-- single\n"), "/boot/cmdline.txt:1: no word for the kernel stands there, not even \"root=\"");
  EXPECT_EQ(why(kLine, "ro skew_tick=1 skew-tick=1\n"),
            "/boot/cmdline.txt:1: \"skew-tick=1\" stands twice (first at /boot/cmdline.txt:1)");
  EXPECT_EQ(why(kLine, "ro irqaffinity=0\n"),
            "/boot/cmdline.txt:1: half of an isolation: \"irqaffinity=0\" stands there, "
            "\"isolcpus=managed_irq,domain,1,3\" does not");
  EXPECT_EQ(why(kLine, std::string(2000, 'x')),
            "/boot/cmdline.txt:1: the line would have 2112 bytes, and kernels read 2047");
}

TEST(EditExtlinux, SaysWhatIsWrongAndWhere) {
  const std::string entry = "LABEL a\n LINUX /i\n APPEND ro\n";
  EXPECT_EQ(why(kExtlinux, entry), "/extlinux.conf:1: no line \"default ...\" from here on");
  EXPECT_EQ(why(kExtlinux, "DEFAULT b\n" + entry),
            "/extlinux.conf:1: DEFAULT names the label \"b\", and there is no such label");
  EXPECT_EQ(why(kExtlinux, "DEFAULT a\n" + entry + entry),
            "/extlinux.conf:5: a second label \"a\", after that of line 2");
  EXPECT_EQ(why(kExtlinux, "DEFAULT a\nDEFAULT a\n" + entry),
            "/extlinux.conf:2: a second \"default\", after that of line 1");
  EXPECT_EQ(why(kExtlinux, "DEFAULT a\n" + entry + " APPEND rw\n"),
            "/extlinux.conf:5: a second \"append\", after that of line 4");
  EXPECT_EQ(why(kExtlinux, "DEFAULT a\nLABEL a\n LINUX /i\nLABEL b\n APPEND ro\n"),
            "/extlinux.conf:2: no line \"append ...\" from here on");
  EXPECT_EQ(why(kExtlinux, "DEFAULT a\nLABEL a\n APPEND\n"),
            "/extlinux.conf:3: no word for the kernel stands there, not even \"root=\"");
}

}  // namespace
}  // namespace lithe::host
