// SPDX-License-Identifier: Apache-2.0
#include "host/read/files.hpp"

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <filesystem>
#include <memory>
#include <system_error>

#include "spine/core/host/fd.hpp"
#include "spine/core/host/files.hpp"

namespace lithe::host {

bool Reading::is_absent() const { return error == ENOENT || error == ENOTDIR; }

std::string HostFiles::place(const std::string& path) const {
  const bool hidden = image_ && ((path + "/").starts_with("/proc/") || (path + "/").starts_with("/sys/"));
  return hidden ? "/dev/null/" + path : root_ + path;  // a file is no folder: nothing is below it
}

Reading HostFiles::read(const std::string& path, std::size_t most_bytes) const {
  Reading reading;
  reading.path = path;
  const Fd file(::open(place(path).c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  std::string text(most_bytes, '\0');
  std::size_t filled = 0;
  while (file.get() >= 0 && filled < text.size()) {
    const ssize_t got = ::read(file.get(), text.data() + filled, text.size() - filled);
    if (got > 0) {
      filled += static_cast<std::size_t>(got);
      continue;
    }
    if (got == 0) {
      text.resize(filled);
      if (text.ends_with('\n')) text.pop_back();
      reading.value = std::move(text);
      return reading;
    }
    if (errno != EINTR) break;
  }
  reading.error = filled == text.size() ? EFBIG : errno;
  return reading;
}

bool HostFiles::is_folder(const std::string& path) const {
  std::error_code failed;
  return std::filesystem::is_directory(place(path), failed);
}

bool HostFiles::is_gone(const std::string& path) const {
  std::error_code failed;
  return std::filesystem::symlink_status(place(path), failed).type() == std::filesystem::file_type::not_found;
}

std::vector<std::string> HostFiles::list(const std::string& folder) const {
  std::vector<std::string> names;
  for (const std::filesystem::path& path : files_in(place(folder))) names.push_back(path.filename().string());
  return names;
}

namespace {

constexpr std::size_t kChunkBytes = std::size_t{64} << 10;

struct Close {
  void operator()(gzFile file) const { gzclose(file); }
};

}  // namespace

Result<std::string> read_packed(const HostFiles& files, const std::string& path, std::size_t most_bytes) {
  const Fd file(::open((files.root() + path).c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!file) return Error{path + ": " + std::strerror(errno)};
  const std::unique_ptr<gzFile_s, Close> packed(gzdopen(::dup(file.get()), "rb"));
  if (!packed) return Error{path + ": cannot be unpacked"};
  std::string text;
  for (;;) {
    const std::size_t had = text.size(), most = std::min(kChunkBytes, most_bytes + 1 - had);
    text.resize(had + most);
    const int got = gzread(packed.get(), text.data() + had, static_cast<unsigned>(most));
    text.resize(had + static_cast<std::size_t>(std::max(got, 0)));
    if (text.size() > most_bytes) return Error{path + ": is too large"};
    if (got > 0) continue;
    int error = Z_OK;  // the end of a file that was cut short reads as its end, with an error
    gzerror(packed.get(), &error);
    if (got < 0 || error != Z_OK) return Error{path + ": is damaged"};
    break;
  }
  if (gzdirect(packed.get()) != 0) return Error{path + ": is not packed with gzip"};
  return text;
}

}  // namespace lithe::host
