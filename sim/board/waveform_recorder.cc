#include "sim/board/waveform_recorder.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <string_view>
#include <system_error>

namespace secondskin::sim {
namespace {

bool write_whole(int fd, const char* data, std::size_t size) noexcept {
  ssize_t written = 0;
  do {
    written = ::write(fd, data, size);
  } while (written < 0 && errno == EINTR);
  return written == static_cast<ssize_t>(size);
}

}  // namespace

WaveformRecorder::WaveformRecorder(const std::string& path) {
  fd_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, 0644);
  if (fd_ < 0) {
    throw std::system_error(errno, std::system_category(), "waveform: cannot write " + path);
  }
  std::string header = "monotonic_ns,slots_on";
  for (std::size_t i = 0; i < wire::kTactorCount; ++i) header += ",drive_" + std::to_string(i);
  header += '\n';
  if (!write_whole(fd_, header.data(), header.size())) {
    const int error = errno;
    ::close(fd_);
    throw std::system_error(error, std::system_category(), "waveform: cannot write " + path);
  }
}

WaveformRecorder::~WaveformRecorder() { ::close(fd_); }

void WaveformRecorder::record(const BoardSample& sample) noexcept {
  if (!first_ && sample.drive == last_.drive && sample.slots_on == last_.slots_on) return;
  first_ = false;
  last_ = sample;
  std::array<char, 512> row;  // 20 digits of time, 2 of slots, 16 drives of at most 7 characters
  char* end = row.data();
  char* const limit = row.data() + row.size();
  const auto put = [&](char c) {
    if (end != limit) *end++ = c;
  };
  end = std::to_chars(end, limit, sample.monotonic_ns).ptr;
  put(',');
  end = std::to_chars(end, limit, sample.slots_on).ptr;
  for (const double drive : sample.drive) {
    put(',');
    if (drive == 0.0) {
      put('0');
    } else {
      end = std::to_chars(end, limit, drive, std::chars_format::fixed, 4).ptr;
    }
  }
  put('\n');
  if (!write_whole(fd_, row.data(), static_cast<std::size_t>(end - row.data()))) ++lost_rows_;
}

}  // namespace secondskin::sim
