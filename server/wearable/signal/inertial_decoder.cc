#include "server/wearable/signal/inertial_decoder.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>

namespace secondskin::server {
namespace {

using wire::kChips;

// The low-pass: a mean of seven A/D samples, three times over. At 140 kHz it falls to a half at
// 9 kHz, and has triple zeros at 20, 40 and 60 kHz, so that a burst of 40 kHz is 60 dB down over
// the sources' 5 kHz; a chip of 10.75 A/D samples keeps 0.88 of its height.
constexpr std::size_t kTaps = 19;
constexpr std::int64_t kHalf = kTaps / 2;
constexpr std::array<float, kTaps> kLowPass = [] {
  std::array<float, kTaps> taps{};
  for (int a = 0; a < 7; ++a) {
    for (int b = 0; b < 7; ++b) {
      for (int c = 0; c < 7; ++c) taps[static_cast<std::size_t>(a + b + c)] += 1.0F / 343.0F;
    }
  }
  return taps;
}();
// How fast the filtered signal crosses from level -1 to +1 at a change of chips [1 / A/D sample].
constexpr double kCrossing = 2.0 * kLowPass[kHalf];

constexpr int kPhases = 8;           // tried within a chip
constexpr double kPhaseGain = 0.25;  // of a sample's timing error
constexpr double kPeriodGain = 0.01;
constexpr double kLevelGain = 0.05;
constexpr std::uint32_t kNotCorrectable = 0xFFFFFFFF;

using Patterns = std::array<std::uint32_t, 1U << 15U>;

// The wrong bits that a syndrome tells of: every pattern of up to three has its own.
const Patterns& patterns() noexcept {
  static const Patterns table = [] {
    Patterns made;
    made.fill(kNotCorrectable);
    made[0] = 0;
    for (std::uint32_t a = 0; a < wire::kWordBits; ++a) {
      for (std::uint32_t b = a; b < wire::kWordBits; ++b) {
        for (std::uint32_t c = b; c < wire::kWordBits; ++c) {
          const std::uint32_t pattern = 1U << a | 1U << b | 1U << c;
          made[wire::bch_syndrome(pattern)] = pattern;
        }
      }
    }
    return made;
  }();
  return table;
}

wire::Chips threshold(const float* soft, double baseline) noexcept {
  wire::Chips chips;
  for (std::size_t k = 0; k < kChips; ++k) chips[k] = soft[k] > baseline ? 1 : 0;
  return chips;
}

}  // namespace

std::optional<wire::InertialCode> decode_chips(const wire::Chips& chips, int& corrected) noexcept {
  const auto& scramble = wire::scrambling();
  const Patterns& table = patterns();
  std::array<std::uint16_t, wire::kWords> words{};
  corrected = 0;
  for (std::size_t w = 0; w < wire::kWords; ++w) {
    std::uint32_t word = 0;
    for (std::size_t k = w; k < kChips; k += wire::kWords) {
      word = word << 1U | static_cast<std::uint32_t>(chips[k] ^ scramble[k]);
    }
    const std::uint32_t wrong = table[wire::bch_syndrome(word)];
    if (wrong == kNotCorrectable) return std::nullopt;
    corrected += std::popcount(wrong);
    words[w] = static_cast<std::uint16_t>((word ^ wrong) >> 15U);
  }
  wire::InertialCode code;
  if (!wire::unpack(words, code)) return std::nullopt;
  return code;
}

InertialDecoder::InertialDecoder(double period, std::size_t at_once)
    : nominal_(period),
      buffer_(at_once + 3 * static_cast<std::size_t>(std::max(period, 0.0)) + 8 * kTaps),
      period_(period) {
  if (!(period >= 4.0 * kChips)) {
    throw std::invalid_argument("a chip of the inertial code needs four A/D samples at least");
  }
  out_.reserve(at_once / static_cast<std::size_t>(period) + 4);
  (void)patterns();  // made now, not in feed()
}

void InertialDecoder::restart() noexcept {
  filled_ = 0;
  begin_ = 0;
  state_ = State::kSearching;
  period_ = nominal_;
  start_ = 0.0;
  failures_ = 0;
}

float InertialDecoder::filtered(std::int64_t position) const noexcept {
  const std::int64_t first = std::clamp<std::int64_t>(position - kHalf - begin_, 0,
                                                      static_cast<std::int64_t>(filled_ - kTaps));
  const float* x = buffer_.data() + first;
  float sum = 0.0F;
  for (std::size_t i = 0; i < kTaps; ++i) sum += kLowPass[i] * x[i];
  return sum;
}

void InertialDecoder::read_chips(double start, std::size_t count, float* soft) const noexcept {
  const double chip = period_ / kChips;
  for (std::size_t k = 0; k < count; ++k) {
    const double centre = start + (static_cast<double>(k) + 0.5) * chip;
    soft[k] = filtered(std::llround(centre));
  }
}

bool InertialDecoder::search() noexcept {
  // Where in a chip the eye is widest, then which chip is the first.
  const double chip = period_ / kChips;
  double best = -1.0, phase = 0.0;
  for (int j = 0; j < kPhases; ++j) {
    const double shift = chip * j / kPhases;
    read_chips(start_ + shift, kChips, soft_.data());
    double mean = 0.0, open = 0.0;
    for (std::size_t k = 0; k < kChips; ++k) mean += soft_[k] / kChips;
    for (std::size_t k = 0; k < kChips; ++k) open += std::abs(soft_[k] - mean);
    if (open > best) {
      best = open;
      phase = shift;
    }
  }
  read_chips(start_ + phase, 2 * kChips - 1, soft_.data());
  double mean = 0.0;
  for (std::size_t k = 0; k < 2 * kChips - 1; ++k) mean += soft_[k] / (2 * kChips - 1);
  for (std::size_t first = 0; first < kChips; ++first) {
    int corrected = 0;
    const auto code = decode_chips(threshold(soft_.data() + first, mean), corrected);
    if (!code) continue;
    baseline_ = mean;
    level_ = best / kChips;
    noise_ = 0.0;
    start_ += phase + static_cast<double>(first) * chip;
    found_ = {start_, *code, corrected};
    track(wire::encode_chips(*code), start_);
    start_ += period_;
    counter_ = (code->counter + 1) % wire::kCounterCodes;
    return true;
  }
  return false;
}

// Takes level, baseline and timing from chips whose truth is known now.
void InertialDecoder::track(const wire::Chips& sent, double start) noexcept {
  const double chip = period_ / kChips;
  std::array<float, kChips> soft{};
  read_chips(start, kChips, soft.data());
  std::array<double, 2> sum{};
  std::array<int, 2> count{};
  for (std::size_t k = 0; k < kChips; ++k) {
    sum[sent[k]] += soft[k];
    ++count[sent[k]];
  }
  if (count[0] == 0 || count[1] == 0) return;
  const double low = sum[0] / count[0], high = sum[1] / count[1];
  double spread = 0.0;
  for (std::size_t k = 0; k < kChips; ++k) {
    const double off = soft[k] - (sent[k] != 0 ? high : low);
    spread += off * off / kChips;
  }
  const bool fresh = state_ == State::kSearching;
  const double gain = fresh ? 1.0 : kLevelGain;
  baseline_ += gain * (0.5 * (low + high) - baseline_);
  level_ += gain * (0.5 * (high - low) - level_);
  noise_ += gain * (std::sqrt(spread) - noise_);
  if (!(level_ > 0.0)) return;

  // At a change of chips the signal crosses the baseline; what it is there tells how late we are.
  double late = 0.0;
  int changes = 0;
  for (std::size_t k = 1; k < kChips; ++k) {
    if (sent[k] == sent[k - 1]) continue;
    const double edge = start + static_cast<double>(k) * chip;
    const std::int64_t position = std::llround(edge);
    const double height = (filtered(position) - baseline_) / (level_ * kCrossing);
    late += (sent[k] != 0 ? height : -height) - (static_cast<double>(position) - edge);
    ++changes;
  }
  if (changes == 0) return;
  late = std::clamp(late / changes, -0.25 * chip, 0.25 * chip);
  start_ -= (fresh ? 1.0 : kPhaseGain) * late;
  if (!fresh) {
    period_ = std::clamp(period_ - kPeriodGain * late, nominal_ * (1.0 - kClockError),
                         nominal_ * (1.0 + kClockError));
  }
}

void InertialDecoder::give(const InertialSample& sample) noexcept {
  ++counts_.samples;
  counts_.corrected += static_cast<std::uint64_t>(sample.corrected);
  out_.push_back(sample);
}

void InertialDecoder::read_sample() noexcept {
  read_chips(start_, kChips, soft_.data());
  int corrected = 0;
  const auto code = decode_chips(threshold(soft_.data(), baseline_), corrected);
  const double start = start_;
  if (code && code->counter == counter_) {
    track(wire::encode_chips(*code), start);
    if (state_ == State::kConfirming) {
      ++counts_.locks;
      give(found_);
    }
    state_ = State::kLocked;
    failures_ = 0;
    give({start, *code, corrected});
  } else {
    counts_.lost += state_ == State::kConfirming ? 2 : 1;
    if (state_ == State::kConfirming || ++failures_ >= kLoseAfter) {
      state_ = State::kSearching;
      period_ = nominal_;
      failures_ = 0;
    }
  }
  start_ += period_;
  counter_ = (counter_ + 1) % wire::kCounterCodes;
}

std::span<const InertialSample> InertialDecoder::feed(
    std::span<const std::int16_t> signal) noexcept {
  out_.clear();
  // Keep what is still needed: from a little before the next sample on.
  const auto keep_from =
      std::clamp<std::int64_t>(static_cast<std::int64_t>(start_) - 2 * kHalf, begin_,
                               begin_ + static_cast<std::int64_t>(filled_));
  const auto drop = static_cast<std::size_t>(keep_from - begin_);
  filled_ -= drop;
  std::memmove(buffer_.data(), buffer_.data() + drop, filled_ * sizeof(float));
  begin_ = keep_from;
  for (const auto x : signal) {
    if (filled_ == buffer_.size()) break;
    buffer_[filled_++] = static_cast<float>(x);
  }
  const auto end = static_cast<double>(begin_ + static_cast<std::int64_t>(filled_)) - kHalf - 2.0;
  while (true) {
    if (state_ == State::kSearching) {
      if (start_ + (2.0 + 1.0 / kChips) * period_ > end) break;
      if (search()) {
        state_ = State::kConfirming;
      } else {
        start_ += period_;
        ++counts_.lost;
      }
    } else {
      if (start_ + period_ > end) break;
      read_sample();
    }
  }
  return out_;
}

}  // namespace secondskin::server
