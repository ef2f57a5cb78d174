#include "motion/whole_file.h"

#include <fmt/format.h>

#include <cerrno>
#include <fstream>
#include <iterator>
#include <system_error>

namespace secondskin {

void write_whole_file(const std::filesystem::path& file, std::string_view bytes) {
  std::filesystem::path partial = file;
  partial += ".partial";
  const auto fail = [&](int error, bool created = true) {
    std::error_code ignored;
    if (created) std::filesystem::remove(partial, ignored);
    throw std::system_error(error != 0 ? error : EIO, std::generic_category(),
                            fmt::format("cannot write {}", file.string()));
  };
  errno = 0;
  std::ofstream out(partial, std::ios::binary | std::ios::trunc);
  if (!out) fail(errno, false);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) fail(errno);
  std::error_code error;
  std::filesystem::rename(partial, file, error);
  if (error) fail(error.value());
}

std::string read_whole_file(const std::filesystem::path& file) {
  const auto fail = [&] {
    throw std::system_error(errno != 0 ? errno : EIO, std::generic_category(),
                            fmt::format("cannot read {}", file.string()));
  };
  errno = 0;
  std::ifstream in(file, std::ios::binary);
  if (!in) fail();
  std::string bytes;
  try {
    bytes.assign(std::istreambuf_iterator<char>(in), {});
  } catch (const std::ios_base::failure&) {  // a folder, too, opens but does not read
    fail();
  }
  return bytes;
}

}  // namespace secondskin
