#include "clients/dashboard/outbox.h"

#include <algorithm>

namespace secondskin::dashboard {

bool Outbox::push(Frame frame) {
  if (!frame.stream) {
    if (bytes_ + frame.size() > most_bytes_) return false;
    bytes_ += frame.size();
    in_order_.push_back(std::move(frame));
    return true;
  }
  const auto waiting = std::find_if(newest_.begin(), newest_.end(), [&](const Frame& other) {
    return other.stream == frame.stream;
  });
  if (waiting == newest_.end()) {
    newest_.push_back(std::move(frame));
  } else {
    *waiting = std::move(frame);
    ++skipped_;
  }
  return true;
}

std::optional<Frame> Outbox::pop() {
  auto& queue = in_order_.empty() ? newest_ : in_order_;
  if (queue.empty()) return std::nullopt;
  Frame frame = std::move(queue.front());
  queue.pop_front();
  if (!frame.stream) bytes_ -= frame.size();
  return frame;
}

void Outbox::forget(std::uint32_t stream) {
  std::erase_if(newest_, [&](const Frame& frame) { return frame.stream == stream; });
}

}  // namespace secondskin::dashboard
