// SPDX-License-Identifier: Apache-2.0
#include "host/read/files.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <filesystem>
#include <system_error>

#include "spine/core/host/fd.hpp"

namespace lithe::host {

bool Reading::is_absent() const { return error == ENOENT || error == ENOTDIR; }

Reading HostFiles::read(const std::string& path, std::size_t most_bytes) const {
  Reading reading;
  reading.path = path;
  const Fd file(::open((root_ + path).c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
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
  return std::filesystem::is_directory(root_ + path, failed);
}

std::vector<std::string> HostFiles::list(const std::string& folder) const {
  std::vector<std::string> names;
  std::error_code failed;
  for (std::filesystem::directory_iterator each(root_ + folder, failed), end; !failed && each != end;
       each.increment(failed)) {
    names.push_back(each->path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace lithe::host
