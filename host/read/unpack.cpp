// SPDX-License-Identifier: Apache-2.0
#include "host/read/unpack.hpp"

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>

#include "spine/core/host/fd.hpp"

namespace lithe::host {
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
