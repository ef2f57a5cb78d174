#include "wire/osc.h"

#include <bit>

namespace secondskin::wire {
namespace {

void put_u32(Datagram& out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8)
    out.push_back(static_cast<std::uint8_t>(value >> shift));
}

// Ended by at least one zero, padded to four bytes.
void put_text(Datagram& out, std::string_view text) {
  out.insert(out.end(), text.begin(), text.end());
  out.insert(out.end(), 4 - text.size() % 4, 0);
}

// "#bundle" and the time tag that means "at once" (OSC 1.0).
Datagram begin_bundle() {
  Datagram bundle;
  put_text(bundle, "#bundle");
  put_u32(bundle, 0);
  put_u32(bundle, 1);
  return bundle;
}

}  // namespace

OscMessage& OscMessage::add(std::int32_t value) {
  types_.push_back('i');
  put_u32(arguments_, static_cast<std::uint32_t>(value));
  return *this;
}

OscMessage& OscMessage::add(float value) {
  types_.push_back('f');
  put_u32(arguments_, std::bit_cast<std::uint32_t>(value));
  return *this;
}

OscMessage& OscMessage::add(std::string_view value) {
  types_.push_back('s');
  put_text(arguments_, value);
  return *this;
}

Datagram OscMessage::encode() const {
  Datagram out;
  put_text(out, address_);
  put_text(out, {reinterpret_cast<const char*>(types_.data()), types_.size()});
  out.insert(out.end(), arguments_.begin(), arguments_.end());
  return out;
}

std::vector<Datagram> osc_bundles(std::span<const OscMessage> messages, std::size_t most_bytes) {
  std::vector<Datagram> bundles;
  for (const OscMessage& message : messages) {
    const Datagram bytes = message.encode();
    if (bundles.empty() || bundles.back().size() + 4 + bytes.size() > most_bytes) {
      bundles.push_back(begin_bundle());
    }
    put_u32(bundles.back(), static_cast<std::uint32_t>(bytes.size()));
    bundles.back().insert(bundles.back().end(), bytes.begin(), bytes.end());
  }
  return bundles;
}

}  // namespace secondskin::wire
