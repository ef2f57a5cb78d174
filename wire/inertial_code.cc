#include "wire/inertial_code.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::wire {
namespace {

constexpr std::uint32_t kGenerator = 0107657;
constexpr int kCheckBits = 15;
constexpr int kStep = 4096 / kValueCodes;  // [12-bit counts]

// 36 bits of values, then the counter: 40 bits, the first value highest.
std::uint64_t body_of(const InertialCode& code) noexcept {
  std::uint64_t body = 0;
  for (const auto value : code.values) body = body << kValueBits | (value & (kValueCodes - 1U));
  return body << kCounterBits | (code.counter & (kCounterCodes - 1U));
}

Chips make_scrambling() noexcept {
  Chips chips{};
  unsigned state = 0x5B;
  for (auto& chip : chips) {
    chip = static_cast<std::uint8_t>(state & 1U);
    const unsigned next = ((state >> 6U) ^ (state >> 5U)) & 1U;
    state = (state << 1U | next) & 0x7FU;
  }
  return chips;
}

}  // namespace

std::uint16_t bch_syndrome(std::uint32_t word) noexcept {
  for (int bit = static_cast<int>(kWordBits) - 1; bit >= kCheckBits; --bit) {
    if ((word >> bit & 1U) != 0) word ^= kGenerator << (bit - kCheckBits);
  }
  return static_cast<std::uint16_t>(word);
}

std::uint32_t bch_encode(std::uint16_t message) noexcept {
  const std::uint32_t shifted = static_cast<std::uint32_t>(message) << kCheckBits;
  return shifted | bch_syndrome(shifted);
}

std::uint8_t inertial_crc(const InertialCode& code) noexcept {
  const std::uint64_t body = body_of(code);
  unsigned crc = 0xFF;
  for (int shift = 32; shift >= 0; shift -= 8) {
    crc ^= static_cast<unsigned>(body >> shift & 0xFFU);
    for (int bit = 0; bit < 8; ++bit) crc = (crc << 1U) ^ ((crc & 0x80U) != 0 ? 0x107U : 0U);
  }
  return static_cast<std::uint8_t>(crc);
}

std::array<std::uint16_t, kWords> pack(const InertialCode& code) noexcept {
  const std::uint64_t all = body_of(code) << 8U | inertial_crc(code);
  return {static_cast<std::uint16_t>(all >> 32U), static_cast<std::uint16_t>(all >> 16U),
          static_cast<std::uint16_t>(all)};
}

bool unpack(const std::array<std::uint16_t, kWords>& words, InertialCode& code) noexcept {
  std::uint64_t all = 0;
  for (const auto word : words) all = all << 16U | word;
  std::uint64_t body = all >> 8U;
  code.counter = static_cast<std::uint8_t>(body & (kCounterCodes - 1U));
  body >>= kCounterBits;
  for (std::size_t i = kInertialChannels; i-- > 0; body >>= kValueBits) {
    code.values[i] = static_cast<std::uint8_t>(body & (kValueCodes - 1U));
  }
  return inertial_crc(code) == (all & 0xFFU);
}

const Chips& scrambling() noexcept {
  static const Chips chips = make_scrambling();
  return chips;
}

Chips encode_chips(const InertialCode& code) noexcept {
  const auto words = pack(code);
  const Chips& scramble = scrambling();
  Chips chips{};
  for (std::size_t w = 0; w < kWords; ++w) {
    const std::uint32_t word = bch_encode(words[w]);
    for (std::size_t bit = 0; bit < kWordBits; ++bit) {
      const std::size_t k = kWords * bit + w;
      chips[k] = static_cast<std::uint8_t>((word >> (kWordBits - 1 - bit) & 1U) ^ scramble[k]);
    }
  }
  return chips;
}

std::uint8_t DeltaModulator::operator()(int value) noexcept {
  const int wanted = value + carry_;
  // Rounded to the nearest step; a shift, so that it rounds alike below zero.
  const int code = std::clamp((wanted + kStep / 2) >> kValueBits, 0, kValueCodes - 1);
  carry_ = std::clamp(wanted - code * kStep, -kStep / 2, kStep / 2);
  return static_cast<std::uint8_t>(code);
}

double InertialCodeNoise::white(double up_to_hz) const noexcept {
  const double x = 2.0 * std::numbers::pi * up_to_hz * period;
  return x > 0.0 ? sample * std::sqrt(std::max(0.0, 1.0 - std::sin(x) / x)) : 0.0;
}

InertialCodeNoise inertial_code_noise(double range, double rate_hz) noexcept {
  InertialCodeNoise noise;
  noise.step = 2.0 * range / kValueCodes;
  noise.sample = noise.step * std::sqrt(2.0 / 12.0);
  noise.period = 1.0 / rate_hz;
  noise.integral = noise.period * noise.step / std::sqrt(12.0);
  return noise;
}

}  // namespace secondskin::wire
