#include "coach/align/position_filter.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

namespace secondskin::coach {
namespace {

// The motion model. How much a tempo drifts decides most: too little and the filter lags behind a
// learner who hurries, too much and it follows noise (docs/alignment.md, section 2, has the trial).
constexpr double kTempoDrift = 0.9;  // standard deviation of the tempo after 1 s
constexpr double kStopRate = 0.3;    // of coming to a stand [1/s]
constexpr double kGoRate = 1.5;      // of setting off again, at a tempo from min_tempo on [1/s]
constexpr float kPositionVariance = 0.25F;  // blur of a position in 1/60 s [frames^2]

// The measurement model: the joints' errors are not independent, neither of each other nor in time.
constexpr double kPoseInformation = 0.6;  // share of the joints that counts as independent
constexpr double kVelocityInformation = 0.3;
constexpr double kVelocityVariance = 0.5;  // [rad^2/s^2], (40 deg/s)^2
constexpr double kVelocityRelative = 0.3;  // of the learner's squared speed
constexpr float kSpeedShare = 0.45F;       // of the velocities' agreement: the speeds alone
constexpr float kLeastLog = -40.0F;

constexpr double kSupport = 0.15;  // half width of the neighbourhood that the estimate averages [s]

// exp(x) for -80 <= x <= 0 within 1e-4 relative; a plain expression, so that loops of it vectorise.
inline float fast_exp(float x) noexcept {
  const float y = x * 1.44269504F;
  const auto n = static_cast<std::int32_t>(y - 0.5F);
  const float f = y - static_cast<float>(n);
  const float p =
      1.0F + f * (0.69314718F + f * (0.24022651F + f * (0.05550411F + f * 0.00961813F)));
  return std::bit_cast<float>((n + 127) << 23) * p;
}

}  // namespace

PositionFilter::PositionFilter(std::size_t frames, double rate_hz, const AlignerOptions& options)
    : frames_(frames),
      width_(std::min(frames, 2 * static_cast<std::size_t>(options.window * rate_hz) + 1)),
      padding_(static_cast<std::size_t>(1.125 * options.max_tempo * kLongestStep * rate_hz) + 8),
      rate_hz_(rate_hz),
      // The rows reach a little beyond the fastest tempo, so that the mean can attain it.
      tempo_step_(static_cast<float>(options.max_tempo * 1.125 / (kTempi - 1))),
      slowest_row_(std::clamp<std::size_t>(
          static_cast<std::size_t>(options.min_tempo / static_cast<double>(tempo_step_)), 1,
          kTempi - 1)),
      probability_(kTempi * width_),
      next_(kTempi * width_),
      mixed_(width_ + 2 * padding_),
      cross_(width_ + 2 * kMargin),
      speed_(width_ + 2 * kMargin),
      likelihood_(width_),
      marginal_(width_) {
  start(1);
}

void PositionFilter::start(std::size_t zone) noexcept {
  begin_ = 0;
  std::fill(probability_.begin(), probability_.end(), 0.0F);
  mix_start(zone, 1.0);
  estimate_ = {};
}

void PositionFilter::mix_start(std::size_t zone, double share) noexcept {
  if (begin_ != 0) return;
  zone = std::clamp<std::size_t>(zone, 1, width_);
  const auto keep = static_cast<float>(1.0 - share);
  for (float& p : probability_) p *= keep;
  // Half of it still, half setting off at a tempo from min_tempo on.
  const auto still = static_cast<float>(0.5 * share / static_cast<double>(zone));
  const auto moving =
      static_cast<float>(0.5 * share / static_cast<double>(zone * (kTempi - slowest_row_)));
  for (std::size_t k = 0; k < kTempi; ++k) {
    if (k > 0 && k < slowest_row_) continue;
    float* const p = row(k);
    for (std::size_t i = 0; i < zone; ++i) p[i] += k == 0 ? still : moving;
  }
}

void PositionFilter::relocate(double position) noexcept {
  const auto centre = static_cast<std::size_t>(
      std::clamp(std::lround(position), 0L, static_cast<long>(frames_ - 1)));
  const std::size_t half = width_ / 2;
  begin_ = std::min(centre > half ? centre - half : 0, frames_ - width_);
  const double sigma = 0.08 * rate_hz_;
  double total = 0.0;
  for (std::size_t i = 0; i < width_; ++i) {
    const double d = (static_cast<double>(begin_ + i) - position) / sigma;
    marginal_[i] = static_cast<float>(std::exp(-0.5 * std::min(d * d, 60.0)));
    total += marginal_[i];
  }
  const auto scale = static_cast<float>(1.0 / (total * kTempi));
  for (std::size_t k = 0; k < kTempi; ++k) {
    float* const p = row(k);
    for (std::size_t i = 0; i < width_; ++i) p[i] = marginal_[i] * scale;
  }
  update_estimate(1.0F);
}

void PositionFilter::predict(double dt, double jump_rate) noexcept {
  // Tempo: diffusion between neighbouring rows, and stopping and setting off at once.
  const double spread = kTempoDrift * kTempoDrift * dt / (tempo_step_ * tempo_step_);
  const auto a = static_cast<float>(std::min(0.5 * spread, 0.3));
  const auto stop = static_cast<float>(std::min(kStopRate * dt, 0.5));
  const auto go = static_cast<float>(std::min(kGoRate * dt, 0.5));
  const auto jump = static_cast<float>(std::min(jump_rate * dt, 0.5));
  const float floor = jump / static_cast<float>(kTempi * width_);
  const float blur = kPositionVariance * static_cast<float>(std::min(dt * rate_hz_, 1.0));

  std::fill(marginal_.begin(), marginal_.end(), 0.0F);  // all moving rows
  for (std::size_t k = 1; k < kTempi; ++k) {
    const float* const p = row(k);
    for (std::size_t i = 0; i < width_; ++i) marginal_[i] += p[i];
  }
  const float* const still = row(0);
  const float each_go = go / static_cast<float>(kTempi - slowest_row_);
  const bool at_end = begin_ + width_ == frames_;

  for (std::size_t k = 0; k < kTempi; ++k) {
    float* const mixed = mixed_.data() + padding_;
    const float* const p = row(k);
    const float* const below = row(k == 0 ? 0 : k - 1);
    const float* const above = row(k == kTempi - 1 ? k : k + 1);
    if (k == 0) {
      for (std::size_t i = 0; i < width_; ++i) {
        mixed[i] = (1.0F - go) * (p[i] + a * (above[i] - p[i])) + stop * marginal_[i];
      }
    } else {
      const float keep = 1.0F - stop;
      const float set_off = k < slowest_row_ ? 0.0F : each_go;
      for (std::size_t i = 0; i < width_; ++i) {
        mixed[i] = keep * (p[i] + a * (below[i] - 2.0F * p[i] + above[i])) + set_off * still[i];
      }
    }

    // Position: on by tempo * dt frames, by a kernel of three taps with exactly that mean. Three
    // taps need a variance of |f| - f^2; all rows get what the worst one needs, so that no tempo is
    // preferred for being sharper.
    const double step = std::min(static_cast<double>(k) * tempo_step_ * dt * rate_hz_,
                                 static_cast<double>(padding_ - 2));
    const auto whole = static_cast<std::size_t>(std::lround(step));
    const auto f = static_cast<float>(step - static_cast<double>(whole));
    const float least = std::fabs(f) - f * f;
    const float variance = std::max(least, k == 0 ? 0.2F * blur : blur);
    const float up = 0.5F * (variance + f * f + f), down = 0.5F * (variance + f * f - f);
    const float same = 1.0F - up - down;
    float* const out = next_.data() + k * width_;
    const float* const from = mixed - whole;
    for (std::size_t i = 0; i < width_; ++i) {
      out[i] = floor + down * from[i + 1] + same * from[i] +
               up * from[static_cast<std::ptrdiff_t>(i) - 1];
    }
    if (at_end) {  // nothing goes beyond the end of the reference
      float over = 0.0F;
      for (std::size_t i = width_ - std::min(width_, whole + 1); i < width_; ++i) {
        if (i + whole + 1 >= width_) over += up * mixed[i];
        if (i + whole >= width_) over += same * mixed[i];
        if (i + whole >= width_ + 1) over += down * mixed[i];
      }
      out[width_ - 1] += over;
    }
  }
  probability_.swap(next_);
}

void PositionFilter::correct(const FrameCosts& costs, const LearnerFeatures& learner,
                             double pose_variance, double information) noexcept {
  const double joints = learner.joints;
  const auto pose_scale =
      static_cast<float>(-0.5 * information * kPoseInformation * joints / pose_variance);
  const auto velocity_scale =
      !learner.has_velocity
          ? 0.0F
          : static_cast<float>(-0.5 * information * kVelocityInformation * joints /
                               (kVelocityVariance +
                                kVelocityRelative * static_cast<double>(learner.speed_square)));
  const float* const pose = costs.pose.data();
  // The learner's velocity is the mean over the lag before now: at tempo v it belongs v * lag / 2
  // before the position. The reference's, taken at tempo 1, is read where it is for the same
  // instant.
  const auto extend = [this](std::span<const float> from, std::vector<float>& to) {
    std::fill_n(to.begin(), kMargin, from.front());
    std::copy(from.begin(), from.end(), to.begin() + kMargin);
    std::fill_n(to.begin() + kMargin + static_cast<std::ptrdiff_t>(width_), kMargin, from.back());
  };
  extend(costs.cross, cross_);
  extend(costs.speed, speed_);
  const float least = *std::min_element(pose, pose + width_);
  const float common = learner.speed_square;
  // Somebody who moves, though in a way of his own, is more likely where the expert moves.
  for (std::size_t i = 0; i < cross_.size(); ++i) {
    cross_[i] += kSpeedShare * (std::sqrt(common * speed_[i]) - cross_[i]);
  }

  float total = 0.0F;
  for (std::size_t k = 0; k < kTempi; ++k) {
    float* const p = row(k);
    const float tempo = static_cast<float>(k) * tempo_step_;
    const auto shift = std::clamp<std::ptrdiff_t>(
        std::lround(0.5 * (1.0 - tempo) * kVelocityLag * rate_hz_), -kMargin, kMargin);
    const float* const cross = cross_.data() + kMargin + shift;
    const float* const speed = speed_.data() + kMargin + shift;
    float sum = 0.0F;
    for (std::size_t i = 0; i < width_; ++i) {
      const float mismatch = common + tempo * (tempo * speed[i] - 2.0F * cross[i]);
      const float log = pose_scale * (pose[i] - least) + velocity_scale * mismatch;
      const float bounded = log > kLeastLog ? log : kLeastLog;
      likelihood_[i] = fast_exp(bounded < 0.0F ? bounded : 0.0F);
    }
    for (std::size_t i = 0; i < width_; ++i) p[i] *= likelihood_[i];
    for (std::size_t i = 0; i < width_; ++i) sum += p[i];
    total += sum;
  }
  update_estimate(total);
}

void PositionFilter::update_estimate(float total) noexcept {
  if (!(total > 0.0F)) {  // every hypothesis ruled out: begin again, anywhere in the window
    const float even = 1.0F / static_cast<float>(kTempi * width_);
    std::fill(probability_.begin(), probability_.end(), even);
    total = 1.0F;
  }
  const float scale = 1.0F / total;
  for (float& p : probability_) p *= scale;
  std::fill(marginal_.begin(), marginal_.end(), 0.0F);
  for (std::size_t k = 0; k < kTempi; ++k) {
    const float* const p = row(k);
    for (std::size_t i = 0; i < width_; ++i) marginal_[i] += p[i];
  }
  // The mean over the neighbourhood with the most probability: a mean over all of it could lie
  // between two hypotheses, where the learner certainly is not.
  const auto support = static_cast<std::size_t>(kSupport * rate_hz_);
  float inside = 0.0F, best = -1.0F;
  std::size_t centre = 0;
  for (std::size_t i = 0; i < std::min(width_, support); ++i) inside += marginal_[i];
  for (std::size_t i = 0; i < width_; ++i) {
    if (i + support < width_) inside += marginal_[i + support];
    if (i > support) inside -= marginal_[i - support - 1];
    if (inside > best) {
      best = inside;
      centre = i;
    }
  }
  const std::size_t from = centre > support ? centre - support : 0;
  const std::size_t to = std::min(width_, centre + support + 1);
  double mass = 0.0, position = 0.0, tempo = 0.0;
  for (std::size_t i = from; i < to; ++i) {
    mass += marginal_[i];
    position += marginal_[i] * static_cast<double>(i);
  }
  for (std::size_t k = 1; k < kTempi; ++k) {
    const float* const p = row(k);
    double sum = 0.0;
    for (std::size_t i = from; i < to; ++i) sum += p[i];
    tempo += sum * static_cast<double>(k) * tempo_step_;
  }
  estimate_.position = static_cast<double>(begin_) + position / mass;
  estimate_.tempo = tempo / mass;
  estimate_.concentration = std::min(1.0, mass);
}

void PositionFilter::follow() noexcept {
  if (width_ == frames_) return;
  const double offset = estimate_.position - static_cast<double>(begin_);
  const auto width = static_cast<double>(width_);
  if (offset > 0.4 * width && offset < 0.6 * width) return;
  const double wanted = std::round(estimate_.position - 0.5 * width);
  const double limit = static_cast<double>(frames_ - width_);
  move_window(static_cast<std::size_t>(std::clamp(wanted, 0.0, limit)));
}

void PositionFilter::move_window(std::size_t begin) noexcept {
  if (begin == begin_) return;
  const auto shift = static_cast<std::ptrdiff_t>(begin) - static_cast<std::ptrdiff_t>(begin_);
  const auto n = static_cast<std::ptrdiff_t>(width_);
  for (std::size_t k = 0; k < kTempi; ++k) {
    float* const p = row(k);
    if (shift > 0) {
      const std::ptrdiff_t keep = std::max<std::ptrdiff_t>(0, n - shift);
      std::copy(p + (n - keep), p + n, p);
      std::fill(p + keep, p + n, 0.0F);
    } else {
      const std::ptrdiff_t keep = std::max<std::ptrdiff_t>(0, n + shift);
      std::copy_backward(p, p + keep, p + n);
      std::fill(p, p + (n - keep), 0.0F);
    }
  }
  begin_ = begin;
}

}  // namespace secondskin::coach
