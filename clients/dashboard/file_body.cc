#include "clients/dashboard/file_body.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace secondskin::dashboard {
namespace {

constexpr std::size_t kBlock = 128 << 10;

std::optional<std::uint64_t> number(std::string_view text) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

std::optional<FileBody> FileBody::open(const std::filesystem::path& file) {
  FileBody body;
  body.fd_ = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  struct stat about {};
  if (body.fd_ < 0 || ::fstat(body.fd_, &about) != 0 || !S_ISREG(about.st_mode)) {
    return std::nullopt;
  }
  body.size_ = body.end_ = static_cast<std::uint64_t>(about.st_size);
  body.written_ns_ = about.st_mtim.tv_sec * 1'000'000'000 + about.st_mtim.tv_nsec;
  return body;
}

FileBody::~FileBody() {
  if (fd_ >= 0) ::close(fd_);
}

FileBody::FileBody(FileBody&& other) noexcept { *this = std::move(other); }

FileBody& FileBody::operator=(FileBody&& other) noexcept {
  std::swap(fd_, other.fd_);
  size_ = other.size_;
  at_ = other.at_;
  end_ = other.end_;
  written_ns_ = other.written_ns_;
  block_ = std::move(other.block_);
  return *this;
}

std::string FileBody::etag() const { return fmt::format("\"{:x}-{:x}\"", size_, written_ns_); }

Range FileBody::seek(std::string_view range) {
  constexpr std::string_view kUnit = "bytes=";
  if (!range.starts_with(kUnit) || range.find(',') != range.npos) return Range::kWhole;
  range.remove_prefix(kUnit.size());
  const auto dash = range.find('-');
  if (dash == range.npos) return Range::kWhole;
  const auto first = number(range.substr(0, dash)), last = number(range.substr(dash + 1));
  const bool open_ended = dash + 1 == range.size();
  if (dash == 0) {
    if (!last) return Range::kWhole;
    if (*last == 0 || size_ == 0) return Range::kUnsatisfiable;
    at_ = size_ - std::min(*last, size_);
    return Range::kPart;
  }
  if (!first || (!last && !open_ended) || (last && *last < *first)) return Range::kWhole;
  if (*first >= size_) return Range::kUnsatisfiable;
  at_ = *first;
  end_ = last ? std::min(*last, size_ - 1) + 1 : size_;
  return Range::kPart;
}

std::string FileBody::content_range(Range range) const {
  if (range == Range::kUnsatisfiable) return fmt::format("bytes */{}", size_);
  return fmt::format("bytes {}-{}/{}", at_, end_ - 1, size_);
}

std::span<const char> FileBody::next() {
  block_.resize(kBlock);
  const auto wanted = static_cast<std::size_t>(std::min<std::uint64_t>(kBlock, left()));
  const ssize_t got = ::pread(fd_, block_.data(), wanted, static_cast<off_t>(at_));
  if (got <= 0) return {};
  at_ += static_cast<std::uint64_t>(got);
  return {block_.data(), static_cast<std::size_t>(got)};
}

}  // namespace secondskin::dashboard
