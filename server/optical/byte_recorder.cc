#include "server/optical/byte_recorder.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstring>
#include <system_error>

namespace secondskin::server {

ByteRecorder::ByteRecorder(const std::string& prefix, const OpticalFormat& format)
    : format_(format) {
  for (std::size_t tag = 0; tag < format.detectors.size(); ++tag) {
    names_.push_back(fmt::format("{}{}.tag", prefix, tag));
    files_.emplace_back(names_.back(), std::ios::binary);
    if (!files_.back()) throw std::system_error(errno, std::generic_category(), names_.back());
  }
}

void ByteRecorder::write(const ProjectorFrame& frame) {
  if (!error_.empty()) return;
  const std::uint64_t lost =
      last_cycle_ && frame.cycle > *last_cycle_ ? frame.cycle - *last_cycle_ - 1 : 0;
  last_cycle_ = frame.cycle;
  std::size_t first = 0;
  for (std::size_t tag = 0; tag < files_.size(); ++tag) {
    const std::size_t count = format_.detectors[tag] * format_.projectors;
    bytes_.assign(lost, wire::kSetStart);
    wire::encode_set({format_.detectors[tag], format_.projectors, format_.gray},
                     {frame.values.data() + first, count}, bytes_);
    first += count;
    files_[tag].write(reinterpret_cast<const char*>(bytes_.data()),
                      static_cast<std::streamsize>(bytes_.size()));
    if (!files_[tag].flush()) {
      error_ = fmt::format("{}: {}", names_[tag], std::strerror(errno));
      return;
    }
  }
}

}  // namespace secondskin::server
