// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/record.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <system_error>

namespace lithe::swap {

int RecordBook::next_number() const {
  int highest = 0;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(dir_, ignored)) {
    if (entry.path().extension() == ".json") {
      highest = std::max(highest, std::atoi(entry.path().stem().c_str()));
    }
  }
  return highest + 1;
}

Result<std::filesystem::path> RecordBook::write(const Json& certificate) {
  std::error_code failure;
  std::filesystem::create_directories(dir_, failure);
  if (failure) {
    return Error{
        fmt::format("cannot create {}: {}; free space there or set LITHE_OUT_DIR", dir_.string(), failure.message())};
  }
  if (next_ == 0) {
    next_ = next_number();
  }
  const std::filesystem::path path = dir_ / fmt::format("{:04}.json", next_);
  if (const auto written = rewrite(path, certificate); !written) {
    return written.error();
  }
  ++next_;
  return path;
}

Result<> RecordBook::rewrite(const std::filesystem::path& path, const Json& certificate) {
  std::error_code failure;
  const std::filesystem::path draft = path.string() + ".draft";
  {
    std::ofstream file(draft, std::ios::binary | std::ios::trunc);
    file << certificate.dump(2, ' ', false, Json::error_handler_t::replace) << '\n';
    file.flush();
    if (!file) {
      file.close();
      std::filesystem::remove(draft, failure);
      return Error{fmt::format("cannot write {}: disk full or read-only? The robot keeps running, this record is lost",
                               path.string())};
    }
  }
  std::filesystem::rename(draft, path, failure);
  if (failure) {
    return Error{fmt::format("cannot rename {}: {}", draft.string(), failure.message())};
  }
  return done();
}

}  // namespace lithe::swap
