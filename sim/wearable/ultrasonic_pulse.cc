#include "sim/wearable/ultrasonic_pulse.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::sim {

UltrasonicPulse::UltrasonicPulse(const Transducer& transducer, double carrier_hz,
                                 double sample_rate_hz)
    : turn_(2.0 * std::numbers::pi * carrier_hz / sample_rate_hz) {
  using Complex = std::complex<double>;
  constexpr double kPi = std::numbers::pi;
  constexpr int kSteps = 8;  // of the integration, a table entry
  constexpr double kRungDown = 1e-3;
  const double step = 1.0 / (kFine * kSteps * sample_rate_hz);  // [s]
  const Complex pole1(-kPi * transducer.bandwidth, 2.0 * kPi * transducer.detuning);
  const Complex pole2(-kPi * transducer.circuit, 0.0), pole3(-kPi * kAmplifier, 0.0);
  const double driven = kCycles / carrier_hz;
  Complex y1 = 0.0, y2 = 0.0, y3 = 0.0;
  std::vector<Complex> table;
  double peak = 0.0;
  for (long n = 0;; ++n) {
    if (n % kSteps == 0) {
      table.push_back(y3);
      peak = std::max(peak, std::abs(y3));
      const double time = static_cast<double>(n) * step;
      if (time > driven && std::abs(y3) < kRungDown * peak) break;
    }
    const double drive = (static_cast<double>(n) + 0.5) * step < driven ? 1.0 : 0.0;
    const Complex x1 = y1, x2 = y2;
    y1 += step * (pole1 * y1 - pole1.real() * drive);
    y2 += step * (pole2 * y2 - pole2.real() * 0.5 * (x1 + y1));
    y3 += step * (pole3 * y3 - pole3.real() * 0.5 * (x2 + y2));
  }
  table.back() = 0.0;
  for (const Complex& value : table) table_.emplace_back(value / peak);
}

double UltrasonicPulse::length() const noexcept {
  return static_cast<double>(table_.size() - 1) / kFine;
}

double UltrasonicPulse::envelope(double samples) const noexcept {
  const double x = samples * kFine;
  const auto i = static_cast<std::size_t>(x);
  if (!(x >= 0.0) || i + 1 >= table_.size()) return 0.0;
  const auto f = static_cast<float>(x - std::floor(x));
  return std::abs((1.0F - f) * table_[i] + f * table_[i + 1]);
}

void UltrasonicPulse::add(double start, double amplitude, double pace,
                          std::span<float> signal) const noexcept {
  const auto first = static_cast<std::ptrdiff_t>(std::max(0.0, std::ceil(start)));
  const double after = (static_cast<double>(first) - start) * pace;
  double x = after * kFine;
  const double step = pace * kFine;
  const double angle = turn_ * after;
  std::complex<float> carrier(static_cast<float>(amplitude * std::cos(angle)),
                              static_cast<float>(amplitude * std::sin(angle)));
  const std::complex<float> turn(static_cast<float>(std::cos(turn_ * pace)),
                                 static_cast<float>(std::sin(turn_ * pace)));
  const double end = static_cast<double>(table_.size() - 1);
  for (auto i = static_cast<std::size_t>(first); i < signal.size() && x < end; ++i, x += step) {
    const auto k = static_cast<std::size_t>(x);
    const auto f = static_cast<float>(x - static_cast<double>(k));
    const std::complex<float> a = table_[k], b = table_[k + 1];
    const float re = a.real() + f * (b.real() - a.real());
    const float im = a.imag() + f * (b.imag() - a.imag());
    signal[i] += re * carrier.real() - im * carrier.imag();
    const float c = carrier.real() * turn.real() - carrier.imag() * turn.imag();
    carrier = {c, carrier.real() * turn.imag() + carrier.imag() * turn.real()};
  }
}

}  // namespace secondskin::sim
