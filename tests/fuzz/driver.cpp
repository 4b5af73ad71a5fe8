// SPDX-License-Identifier: Apache-2.0
// The same program twice. With libFuzzer: its own command line, and `--seeds DIR`, which writes the target's seeds
// there. Without: every seed as it is and spoilt in a few hundred ways that are the same each time, or the files named.
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>

#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {

void require(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "refuted: %s\n", what);
#ifdef LITHE_FUZZ
  std::abort();  // libFuzzer keeps the input
#else
  std::_Exit(1);
#endif
}

namespace {

void write_seeds(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  int number = 0;
  for (const Seed& seed : seeds()) {
    std::ofstream file(folder / ("seed" + std::to_string(number++)), std::ios::binary);
    file.write(reinterpret_cast<const char*>(seed.data()), static_cast<std::streamsize>(seed.size()));
  }
}

}  // namespace
}  // namespace lithe::fuzz

#ifdef LITHE_FUZZ

extern "C" int LLVMFuzzerInitialize(int* count, char*** words) {
  if (*count != 3 || std::string_view((*words)[1]) != "--seeds") return 0;
  lithe::fuzz::write_seeds((*words)[2]);
  std::exit(0);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  lithe::fuzz::run({data, size});
  return 0;
}

#else

namespace lithe::fuzz {
namespace {

using Random = std::mt19937;
constexpr int kSpoiltWays = 200;

Seed spoilt(Seed bytes, const Seed& other, Random& random) {
  const auto place = [&](std::size_t size) { return static_cast<std::ptrdiff_t>(size == 0 ? 0 : random() % size); };
  for (std::uint32_t turns = 1 + random() % 4; turns > 0 && !bytes.empty(); --turns) {
    const auto at = bytes.begin() + place(bytes.size());
    switch (random() % 6) {
      case 0:
        *at = static_cast<std::uint8_t>(random());
        break;
      case 1:
        *at = static_cast<std::uint8_t>(*at ^ 1U << random() % 8);
        break;
      case 2:
        bytes.erase(at, at + std::min<std::ptrdiff_t>(1 + random() % 8, bytes.end() - at));
        break;
      case 3:
        bytes.insert(at, 1 + random() % 8, static_cast<std::uint8_t>(random()));
        break;
      case 4: {  // said twice
        const Seed part(at, at + std::min<std::ptrdiff_t>(1 + random() % 64, bytes.end() - at));
        bytes.insert(bytes.begin() + place(bytes.size()), part.begin(), part.end());
        break;
      }
      default:
        bytes.insert(at, other.begin() + place(other.size()), other.end());
    }
  }
  return bytes;
}

void replay() {
  const std::vector<Seed> all = seeds();
  run({});
  for (const Seed& seed : all) run(seed);
  Random random(1);
  for (const Seed& seed : all)
    for (int way = 0; way < kSpoiltWays; ++way) run(spoilt(seed, all[random() % all.size()], random));
  std::printf("%zu seeds, each spoilt in %d ways\n", all.size(), kSpoiltWays);
}

}  // namespace
}  // namespace lithe::fuzz

int main(int count, char** words) {
  using namespace lithe::fuzz;
  if (count == 3 && std::string_view(words[1]) == "--seeds") {
    write_seeds(words[2]);
    return 0;
  }
  if (count == 1) replay();
  for (int i = 1; i < count; ++i) {
    std::ifstream file(words[i], std::ios::binary);
    run(Seed(std::istreambuf_iterator<char>(file), {}));
  }
  return 0;
}

#endif
