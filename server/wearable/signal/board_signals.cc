#include "server/wearable/signal/board_signals.h"

#include <algorithm>
#include <limits>

namespace secondskin::server {

BoardSignals::Channel::Channel(const Garment& garment, double period)
    : decoder(period, garment.slot_samples),
      finder(garment.sample_rate_hz, garment.carrier_hz, garment.slot_samples) {
  samples.reserve(garment.slot_samples / static_cast<std::size_t>(period) + 8);
}

BoardSignals::BoardSignals(const Garment& garment)
    : period_(garment.sample_rate_hz / garment.inertial_rate_hz),
      slot_samples_(garment.slot_samples),
      arrivals_(garment.boards.size()),
      nothing_(garment.slot_samples, 0) {
  for (std::size_t i = 0; i < garment.boards.size(); ++i) {
    channels_.push_back(std::make_unique<Channel>(garment, period_));
  }
}

void BoardSignals::decode(Channel& channel, std::span<const std::int16_t> signal) noexcept {
  for (InertialSample sample : channel.decoder.feed(signal)) {
    sample.start += origin_;
    if (channel.samples.size() < channel.samples.capacity()) channel.samples.push_back(sample);
  }
}

void BoardSignals::bridge(std::uint32_t missing) noexcept {
  for (auto& channel : channels_) {
    channel->finder.forget();
    if (missing <= kBridgedSlots) {
      for (std::uint32_t i = 0; i < missing; ++i) decode(*channel, nothing_);
    } else {
      channel->decoder.restart();
    }
  }
  if (missing > kBridgedSlots) origin_ = begin_;
}

void BoardSignals::process(const wire::GarmentSlot& slot) noexcept {
  begin_ = static_cast<double>(slot.sequence) * static_cast<double>(slot_samples_);
  for (auto& channel : channels_) channel->samples.clear();
  if (!last_) {
    origin_ = begin_;
  } else if (slot.sequence != *last_ + 1) {
    bridge(slot.sequence > *last_ ? slot.sequence - *last_ - 1
                                  : std::numeric_limits<std::uint32_t>::max());
  }
  last_ = slot.sequence;
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    Channel& channel = *channels_[i];
    const auto signal = slot.board(i, slot_samples_);
    decode(channel, signal);
    arrivals_[i] = channel.finder.find(signal);
    if (!slot.source) arrivals_[i].reset();
    if (slot.source) ++(arrivals_[i] ? channel.arrivals : channel.unheard);
    channel.clipped +=
        static_cast<std::uint64_t>(std::count_if(signal.begin(), signal.end(), [](std::int16_t x) {
          return x == std::numeric_limits<std::int16_t>::min() ||
                 x == std::numeric_limits<std::int16_t>::max();
        }));
  }
}

BoardHealth BoardSignals::health(std::size_t board) const noexcept {
  const Channel& channel = *channels_[board];
  BoardHealth health;
  health.inertial = channel.decoder.counts();
  health.locked = channel.decoder.locked();
  health.level = channel.decoder.level();
  health.chip_noise = channel.decoder.noise();
  health.ambient_noise = channel.finder.noise();
  health.arrivals = channel.arrivals;
  health.unheard = channel.unheard;
  health.clipped = channel.clipped;
  return health;
}

}  // namespace secondskin::server
