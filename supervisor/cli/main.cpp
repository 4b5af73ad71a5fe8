// SPDX-License-Identifier: Apache-2.0
// The `lithe` command: words in, one function of act.hpp out.
#include <signal.h>

#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/parse/words.hpp"

namespace {

using namespace lithe::cli;

int run(int argc, char** argv, CommandLine& words) {
  CLI::App app;
  add_words(app, words);
  const std::vector<std::string> all(argv + 1, argv + argc);
  if (const auto wrong = wrong_verb(app, all)) {
    words.context.json = asks_for_json(all);
    return refuse(words.context, *wrong);
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& wrong) {
    if (wrong.get_exit_code() == 0) return app.exit(wrong);  // help, version
    words.context.json = asks_for_json(all);
    std::string why = wrong.what();
    if (dynamic_cast<const CLI::ConversionError*>(&wrong) != nullptr) why += ": a number is wanted";
    return refuse(words.context, {"usage", why, "see how it is written: lithe help" + verb_of(app, all)});
  }
  return words.code;
}

}  // namespace

int main(int argc, char** argv) {
  ::signal(SIGXFSZ, SIG_IGN);  // a file over its limit is an error with words
  try {
    CommandLine words;
    try {
      return run(argc, argv, words);
    } catch (const lithe::control::Refusal& refusal) {
      return refuse(words.context, refusal);
    } catch (const std::exception& wrong) {
      return refuse(words.context, {"internal", std::string("lithe itself went wrong: ") + wrong.what(),
                                    "see how the robot is: lithe status"});
    }
  } catch (...) {
    std::fputs("lithe: went wrong, and cannot even say how\n", stderr);
  }
  return 3;
}
