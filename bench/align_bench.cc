// How far is the aligner from the truth, and what does it cost? Four tables:
//
//   warps        real motions under known time warps, with what goes wrong in practice
//   repetitions  one repetition of a technique followed in another of the same person
//   people       one person's exercise followed in other people's
//   counts       repetitions counted in whole recordings, with other techniques and exercises
//
// next to Dixon's online time warping (S. Dixon, "Live tracking of musical performances using
// on-line time warping", DAFx 2005) and, where no truth is known, against full offline dynamic time
// warping. docs/alignment.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "coach/align/aligner.h"
#include "coach/align/expert_average.h"
#include "motion/kinematics.h"
#include "motion/marker_file.h"
#include "motion/rotation.h"
#include "server/markers/marker_source.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::coach;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kLearnerRate = 62.5;            // [Hz], the paper's
constexpr double kMovingSpeed = 15.0 * kDegree;  // RMS over the joints [rad/s]

// Processor time of this thread [s]: what other processes do does not count.
double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double rms_distance(const Pose& a, const Pose& b) {
  double sum = 0.0;
  std::size_t n = 0;
  for (std::size_t j = 1; j < kJointCount; ++j) {
    if (a.confidence[j] <= 0.0F || b.confidence[j] <= 0.0F) continue;
    const double d = geodesic_distance(a.q_PB[j], b.q_PB[j]);
    sum += d * d;
    ++n;
  }
  return n > 0 ? std::sqrt(sum / static_cast<double>(n)) : 0.0;
}

// One learner's stream and the truth about it.
struct Trial {
  std::vector<std::int64_t> stamps_ns;
  std::vector<Pose> poses;
  std::vector<double> reference_time;  // truth [s]
  std::vector<bool> moving;
  std::vector<double> events;  // when a pause or a skip ended [s since the start]
};

struct Condition {
  std::string name;
  double noise_deg = 0.0;          // per axis of each joint
  double noise_correlation = 0.0;  // 0 white; else its corner frequency [Hz]
  double dropped = 0.0;            // share of frames
  double jitter = 0.0;             // of the stamps [s]
  bool pauses = false, skips = false, missing = false, small_body = false;
};

// A smooth tempo between 1/2 and 2 of period 1.5 to 4 s, always forward, with pauses and skips.
Trial make_trial(const Motion& reference, const Condition& condition, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const double duration = reference.duration();
  const double a = 0.45 + 0.15 * uniform(random), b = 0.35;
  const double pa = 2.0 + 2.0 * uniform(random), pb = 1.2 + 0.8 * uniform(random);
  const double fa = 2.0 * std::numbers::pi * uniform(random);
  const double fb = 2.0 * std::numbers::pi * uniform(random);
  const Motion body =
      condition.small_body ? fit_to(reference, canonical_skeleton(1.45)) : reference;

  Trial trial;
  std::vector<Eigen::Vector3d> noise(kJointCount, Eigen::Vector3d::Zero());
  Pose pose(kJointCount), ahead(kJointCount);
  double x = 0.0, pause_left = 0.0;
  double next_event = 1.5 + uniform(random);
  const double dt = 1.0 / kLearnerRate;
  for (std::size_t i = 0; x < duration; ++i) {
    const double t = static_cast<double>(i) * dt;
    const double log_tempo = std::clamp(a * std::sin(2.0 * std::numbers::pi * t / pa + fa) +
                                            b * std::sin(2.0 * std::numbers::pi * t / pb + fb),
                                        -std::numbers::ln2, std::numbers::ln2);
    double tempo = std::exp(log_tempo);
    if ((condition.pauses || condition.skips) && x > next_event && x + 3.0 < duration) {
      next_event = x + 3.0 + uniform(random);
      if (condition.pauses) pause_left = 1.0;
      if (condition.skips) {
        const double to = x + 0.8 + 0.6 * uniform(random);
        x = to;
        next_event = x + 3.0 + uniform(random);
        trial.events.push_back(t);
      }
    }
    if (pause_left > 0.0) {
      tempo = 0.0;
      pause_left -= dt;
      if (pause_left <= 0.0) trial.events.push_back(t);
    }
    sample(body, x, pose);
    sample(body, x + 0.02, ahead);
    const double speed = rms_distance(pose, ahead) / 0.02 * tempo;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const double sigma = condition.noise_deg * kDegree;
      const Eigen::Vector3d fresh(normal(random), normal(random), normal(random));
      if (condition.noise_correlation > 0.0) {
        const double keep = std::exp(-2.0 * std::numbers::pi * condition.noise_correlation * dt);
        if (i == 0) noise[j] = sigma * fresh;
        noise[j] = keep * noise[j] + std::sqrt(1.0 - keep * keep) * sigma * fresh;
      } else {
        noise[j] = sigma * fresh;
      }
      if (sigma > 0.0) pose.q_PB[j] = (pose.q_PB[j] * quaternion_from(noise[j])).normalized();
    }
    if (condition.missing) {
      for (const Joint j : {Joint::kRightShoulder, Joint::kRightElbow, Joint::kRightWrist,
                            Joint::kLeftKnee, Joint::kHead}) {
        pose.confidence[index(j)] = 0.0F;
      }
    }
    if (!(condition.dropped > 0.0 && uniform(random) < condition.dropped)) {
      const double late = condition.jitter * (2.0 * uniform(random) - 1.0);
      trial.stamps_ns.push_back(static_cast<std::int64_t>((t + late + 1.0) * 1e9));
      trial.poses.push_back(pose);
      trial.reference_time.push_back(x);
      trial.moving.push_back(speed > kMovingSpeed);
    }
    x += tempo * dt;
  }
  return trial;
}

// Dixon's OLTW on the same distances (no velocity, no tempo), its window 500 frames, runs of 3.
class OnlineTimeWarping {
 public:
  OnlineTimeWarping(const Motion& reference, std::size_t most_frames)
      : reference_(reference),
        n_(reference.poses.size()),
        cost_(most_frames * n_, std::numeric_limits<float>::infinity()),
        live_(most_frames, Pose(kJointCount)) {}

  double update(const Pose& pose) {
    live_[rows_] = pose;
    ++rows_;
    if (rows_ == 1) {
      at(0, 0) = static_cast<float>(rms_distance(live_[0], reference_.poses[0]));
      return 0.0;
    }
    while (true) {
      const int step = increment();
      if (step != kColumn) {
        ++t_;
        for (std::size_t k = j_ + 1 > kWindow ? j_ + 1 - kWindow : 0; k <= j_; ++k) evaluate(t_, k);
      }
      if (step != kRow && j_ + 1 < n_) {
        ++j_;
        for (std::size_t k = t_ + 1 > kWindow ? t_ + 1 - kWindow : 0; k <= t_; ++k) evaluate(k, j_);
      }
      run_ = step == previous_ ? run_ + 1 : 1;
      if (step != kBoth) previous_ = step;
      if (step != kColumn) break;
    }
    std::size_t best = j_;
    for (std::size_t k = j_ + 1 > kWindow ? j_ + 1 - kWindow : 0; k <= j_; ++k) {
      if (normal(t_, k) < normal(t_, best)) best = k;
    }
    return static_cast<double>(best) / reference_.rate_hz;
  }

 private:
  static constexpr std::size_t kWindow = 500;
  enum { kNone, kRow, kColumn, kBoth };

  float& at(std::size_t t, std::size_t j) { return cost_[t * n_ + j]; }
  float normal(std::size_t t, std::size_t j) { return at(t, j) / static_cast<float>(t + j + 1); }

  void evaluate(std::size_t t, std::size_t j) {
    const auto d = static_cast<float>(rms_distance(live_[t], reference_.poses[j]));
    float best = std::numeric_limits<float>::infinity();
    if (t > 0) best = std::min(best, at(t - 1, j) + d);
    if (j > 0) best = std::min(best, at(t, j - 1) + d);
    if (t > 0 && j > 0) best = std::min(best, at(t - 1, j - 1) + 2.0F * d);
    at(t, j) = best;
  }

  int increment() {
    if (j_ + 1 >= n_) return kRow;
    if (t_ < 3) return kBoth;
    if (run_ > 3) return previous_ == kRow ? kColumn : kRow;
    std::size_t x = t_, y = j_;
    for (std::size_t k = t_ + 1 > kWindow ? t_ + 1 - kWindow : 0; k <= t_; ++k) {
      if (normal(k, j_) < normal(x, y)) x = k, y = j_;
    }
    for (std::size_t k = j_ + 1 > kWindow ? j_ + 1 - kWindow : 0; k <= j_; ++k) {
      if (normal(t_, k) < normal(x, y)) x = t_, y = k;
    }
    if (x < t_) return kColumn;  // the path ended earlier in the performance: take more reference
    if (y < j_) return kRow;
    return kBoth;
  }

  const Motion& reference_;
  std::size_t n_;
  std::vector<float> cost_;
  std::vector<Pose> live_;
  std::size_t rows_ = 0, t_ = 0, j_ = 0;
  int previous_ = kNone;
  int run_ = 0;
};

struct Metrics {
  std::vector<double> error;       // on moving frames that are followed [s]
  std::vector<double> still;       // on the others, to the nearest time with an equal pose [s]
  std::vector<double> still_pose;  // pose error there [rad]
  std::vector<double> cost;        // of each frame [s]
  std::vector<double> recovery;    // [s]
  std::vector<double> peak;        // at the limbs' highest speeds, where followed [s]
  std::size_t moving = 0, followed = 0, lost = 0, frames = 0, peaks = 0, leaps = 0;
};

double quantile(std::vector<double> v, double q) {
  if (v.empty()) return 0.0;
  const auto at = static_cast<std::size_t>(q * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(at), v.end());
  return v[at];
}

struct Answer {
  double time;
  Phase phase;
  bool followed() const { return phase == Phase::kMoving || phase == Phase::kPaused; }
};
using Follow = std::function<Answer(std::int64_t, const Pose&)>;

// A leap: the estimate goes where no tempo would have brought it, and where the expert's pose is
// another.
bool leaps(const Motion& reference, const Answer& before, const Answer& now, double dt) {
  constexpr double kSlack = 0.05, kOtherPose = 8.0 * kDegree;
  if (!before.followed() || !now.followed()) return false;
  const double moved = now.time - before.time;
  if (moved > -kSlack && moved < 2.25 * dt + kSlack) return false;
  Pose a(kJointCount), b(kJointCount);
  sample(reference, before.time, a);
  sample(reference, now.time, b);
  return rms_distance(a, b) > kOtherPose;
}

// How far a time is from the nearest one whose pose is within a degree of the pose at `truth` [s].
double outside_equal_poses(const Motion& reference, double truth, double time) {
  constexpr double kEqual = 1.0 * kDegree;
  Pose at_truth(kJointCount), pose(kJointCount);
  sample(reference, truth, at_truth);
  double nearest = std::fabs(time - truth);
  for (double off = 0.0; off < nearest; off += 0.5 / reference.rate_hz) {
    for (const double t : {time - off, time + off}) {
      if (t < 0.0 || t > reference.duration()) continue;
      sample(reference, t, pose);
      if (rms_distance(pose, at_truth) <= kEqual) return off;
    }
  }
  return nearest;
}

void run(const Motion& reference, const Trial& trial, Metrics& m, const Follow& follow) {
  std::size_t event = 0;
  double event_start = -1.0;
  Pose there(kJointCount), truth_pose(kJointCount);
  Answer before{0.0, Phase::kWaiting};
  for (std::size_t i = 0; i < trial.poses.size(); ++i) {
    const double begin = cpu_time();
    const Answer answer = follow(trial.stamps_ns[i], trial.poses[i]);
    m.cost.push_back(cpu_time() - begin);
    const double truth = trial.reference_time[i];
    const double t = static_cast<double>(trial.stamps_ns[i]) * 1e-9 - 1.0;
    ++m.frames;
    const double error = std::fabs(answer.time - truth);
    while (event < trial.events.size() && t >= trial.events[event]) {
      if (event_start >= 0.0) m.recovery.push_back(t - event_start);
      event_start = trial.events[event++];
    }
    if (event_start >= 0.0 && error < 0.1) {
      m.recovery.push_back(t - event_start);
      event_start = -1.0;
    }
    if (event_start < 0.0 && leaps(reference, before, answer, 1.0 / kLearnerRate)) ++m.leaps;
    before = answer;
    const bool inside = truth > 0.5 && truth < reference.duration() - 0.2;
    if (!inside) continue;
    if (answer.phase == Phase::kLost) ++m.lost;
    if (trial.moving[i]) {
      ++m.moving;
      if (answer.followed()) {
        ++m.followed;
        m.error.push_back(error);
      }
    } else if (answer.followed()) {
      sample(reference, answer.time, there);
      sample(reference, truth, truth_pose);
      m.still_pose.push_back(rms_distance(there, truth_pose));
      m.still.push_back(outside_equal_poses(reference, truth, answer.time));
    }
  }
}

// One performance followed in another. The "truth" is the offline path, which knows the future.
struct Performance {
  Motion motion;
  std::vector<double> peaks;  // of limb speed [s]; one for each of the technique's peaks
};

void run_performance(const Reference& reference, const std::vector<double>& reference_peaks,
                     const Performance& learner, Metrics& m, const Follow& follow) {
  const Motion stream = resample(learner.motion, kReferenceRate);
  const std::vector<double> path = warp_onto(stream, reference.motion, reference.weight);
  Answer before{0.0, Phase::kWaiting};
  for (std::size_t i = 0; i < stream.poses.size(); ++i) {
    const double t = static_cast<double>(i) / kReferenceRate;
    const double begin = cpu_time();
    const Answer answer = follow(static_cast<std::int64_t>((t + 1.0) * 1e9), stream.poses[i]);
    m.cost.push_back(cpu_time() - begin);
    ++m.frames;
    if (answer.phase == Phase::kLost) ++m.lost;
    if (leaps(reference.motion, before, answer, 1.0 / kReferenceRate)) ++m.leaps;
    for (std::size_t k = 0; k < reference_peaks.size(); ++k) {
      if (std::fabs(learner.peaks[k] - t) > 0.5 / kReferenceRate) continue;
      ++m.peaks;
      if (answer.followed()) {
        m.peak.push_back(std::fabs(answer.time + (learner.peaks[k] - t) - reference_peaks[k]));
      }
    }
    before = answer;
    const double speed =
        i == 0 ? 0.0 : rms_distance(stream.poses[i], stream.poses[i - 1]) * kReferenceRate;
    if (speed <= kMovingSpeed) continue;
    ++m.moving;
    if (!answer.followed()) continue;
    ++m.followed;
    m.error.push_back(std::fabs(answer.time - path[i] / reference.motion.rate_hz));
  }
}

Follow aligner_for(const std::shared_ptr<const Reference>& reference) {
  const auto aligner = std::make_shared<Aligner>(reference);
  return [aligner](std::int64_t stamp, const Pose& pose) {
    const AlignmentEstimate e = aligner->update(stamp, pose);
    return Answer{e.reference_time, e.phase};
  };
}

Follow oltw_for(const Motion& reference, std::size_t most_frames) {
  const auto oltw = std::make_shared<OnlineTimeWarping>(reference, most_frames);
  return [oltw](std::int64_t, const Pose& pose) {
    return Answer{oltw->update(pose), Phase::kMoving};
  };
}

nlohmann::json report(const std::string& method, const std::string& condition, const Metrics& m) {
  const auto within = [&](double limit) {
    const auto n =
        std::count_if(m.error.begin(), m.error.end(), [&](double e) { return e <= limit; });
    return m.error.empty() ? 0.0
                           : 100.0 * static_cast<double>(n) / static_cast<double>(m.error.size());
  };
  double sum = 0.0;
  for (const double e : m.error) sum += e;
  const auto share = [](std::size_t a, std::size_t b) {
    return b == 0 ? 0.0 : 100.0 * static_cast<double>(a) / static_cast<double>(b);
  };
  return {{"method", method},
          {"condition", condition},
          {"frames", m.frames},
          {"median_ms", 1e3 * quantile(m.error, 0.5)},
          {"mean_ms", m.error.empty() ? 0.0 : 1e3 * sum / static_cast<double>(m.error.size())},
          {"p95_ms", 1e3 * quantile(m.error, 0.95)},
          {"within_50_ms", within(0.05)},
          {"within_100_ms", within(0.1)},
          {"within_250_ms", within(0.25)},
          {"within_500_ms", within(0.5)},
          {"lost", share(m.lost, m.frames)},
          {"coverage", share(m.followed, m.moving)},
          {"recovery_p95_ms", 1e3 * quantile(m.recovery, 0.95)},
          {"still_p95_ms", 1e3 * quantile(m.still, 0.95)},
          {"still_pose_p95_deg", quantile(m.still_pose, 0.95) / kDegree},
          {"leaps", m.leaps},
          {"peaks", m.peaks},
          {"peaks_followed", m.peak.size()},
          {"peak_median_ms", 1e3 * quantile(m.peak, 0.5)},
          {"peak_p95_ms", 1e3 * quantile(m.peak, 0.95)},
          {"cost_p50_us", 1e6 * quantile(m.cost, 0.5)},
          {"cost_p99_us", 1e6 * quantile(m.cost, 0.99)}};
}

std::string number(const nlohmann::json& r, const char* field, int decimals) {
  return fmt::format("{:.{}f}", r[field].get<double>(), decimals);
}

void print_warp(const nlohmann::json& r) {
  fmt::print(
      "{:<8} {:<21} {:>6} {:>5} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>6} {:>7} {:>6} {:>6} "
      "{:>5} {:>6} {:>6}\n",
      r["method"].get<std::string>(), r["condition"].get<std::string>(), number(r, "median_ms", 1),
      number(r, "mean_ms", 1), number(r, "p95_ms", 1), number(r, "within_50_ms", 1),
      number(r, "within_100_ms", 1), number(r, "within_250_ms", 1), number(r, "within_500_ms", 1),
      number(r, "lost", 1), number(r, "coverage", 1), number(r, "recovery_p95_ms", 0),
      number(r, "still_p95_ms", 0), number(r, "still_pose_p95_deg", 1),
      r["leaps"].get<std::size_t>(), number(r, "cost_p50_us", 1), number(r, "cost_p99_us", 1));
}

void print_warp_header() {
  fmt::print(
      "{:<8} {:<21} {:>6} {:>5} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>6} {:>7} {:>6} {:>6} "
      "{:>5} {:>6} {:>6}\n",
      "method", "condition", "median", "mean", "p95 ms", "<50", "<100", "<250", "<500%", "lost",
      "cover", "recov95", "still", "pose", "leaps", "p50 us", "p99 us");
}

void print_performance(const nlohmann::json& r) {
  fmt::print(
      "{:<14} {:<24} {:>6} {:>5} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>6} {:>5} {:>8} "
      "{:>6} {:>6} {:>6}\n",
      r["method"].get<std::string>(), r["condition"].get<std::string>(), number(r, "median_ms", 1),
      number(r, "mean_ms", 1), number(r, "p95_ms", 0), number(r, "within_50_ms", 1),
      number(r, "within_100_ms", 1), number(r, "within_250_ms", 1), number(r, "within_500_ms", 1),
      number(r, "lost", 1), number(r, "coverage", 1), r["leaps"].get<std::size_t>(),
      fmt::format("{}/{}", r["peaks_followed"].get<std::size_t>(), r["peaks"].get<std::size_t>()),
      number(r, "peak_median_ms", 1), number(r, "peak_p95_ms", 0), number(r, "cost_p99_us", 1));
}

void print_performance_header() {
  fmt::print(
      "{:<14} {:<24} {:>6} {:>5} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>6} {:>5} {:>8} "
      "{:>6} {:>6} {:>6}\n",
      "method", "reference <- learner", "median", "mean", "p95 ms", "<50", "<100", "<250", "<500%",
      "lost", "cover", "leaps", "peaks", "median", "p95 ms", "p99 us");
}

// ---- the recordings ----------------------------------------------------------------------------

// CMU subject 135's techniques: the times of the pairs of limb-speed peaks are the data's notes'.
struct Recording {
  std::string technique;  // and the reference that has its weights
  std::string file;
  std::vector<std::pair<double, double>> pairs;  // [s]
};

const std::vector<Recording>& karate() {
  static const std::vector<Recording> recordings{
      {"low_block", "135_05_gedanbarai.bvh", {{1.1, 2.8}, {4.7, 6.6}, {8.8, 10.4}, {12.1, 13.9}}},
      {"roundhouse_kick", "135_07_mawashigeri.bvh", {{1.0, 3.7}, {6.4, 9.4}}},
      {"stepping_punch", "135_09_oiduki.bvh", {{2.5, 4.4}, {6.3, 8.2}, {10.9, 12.6}, {14.2, 15.8}}},
      {"knife_hand_block",
       "135_10_syutouuke.bvh",
       {{1.9, 3.4}, {4.9, 6.4}, {8.0, 9.8}, {11.4, 12.9}}}};
  return recordings;
}

constexpr std::array<Joint, 4> kLimbEnds{Joint::kLeftWrist, Joint::kRightWrist, Joint::kLeftAnkle,
                                         Joint::kRightAnkle};

// Speed of a limb's end beside the pelvis [m/s].
double limb_speed(const Motion& motion, double time, Joint end) {
  constexpr double kStep = 0.02;
  const auto place = [&](double t) -> Eigen::Vector3d {
    Pose pose(kJointCount);
    sample(motion, t, pose);
    std::vector<Eigen::Isometry3d> X_WB(kJointCount);
    forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, X_WB);
    return X_WB[index(Joint::kPelvis)].inverse() * X_WB[index(end)].translation();
  };
  return (place(time + kStep) - place(time - kStep)).norm() / (2.0 * kStep);
}

struct Peak {
  Joint end{};
  double time = 0.0;
};

// The highest speed of a limb (of any, if none is named) within 0.35 s of the time noted.
Peak peak_near(const Motion& motion, double noted, std::optional<Joint> end) {
  Peak peak;
  double highest = -1.0;
  for (double t = noted - 0.35; t <= noted + 0.35; t += 1.0 / 240.0) {
    for (const Joint candidate : kLimbEnds) {
      if (end && candidate != *end) continue;
      const double speed = limb_speed(motion, t, candidate);
      if (speed > highest) highest = speed, peak = {candidate, t};
    }
  }
  return peak;
}

Motion cut(const Motion& motion, double from, double to) {
  const auto frame = [&](double t) {
    return static_cast<std::size_t>(std::lround(t * motion.rate_hz));
  };
  return slice(motion, frame(from), std::min(frame(to) + 1, motion.poses.size()));
}

// From 0.9 s before a pair's first peak to 1 s after its second, at most to midway between pairs.
std::pair<double, double> window_of(const Recording& recording, std::size_t k, double duration) {
  const auto& pairs = recording.pairs;
  double from = pairs[k].first - 0.9, to = pairs[k].second + 1.0;
  if (k > 0) from = std::max(from, 0.5 * (pairs[k - 1].second + pairs[k].first));
  if (k + 1 < pairs.size()) to = std::min(to, 0.5 * (pairs[k].second + pairs[k + 1].first));
  return {std::max(from, 0.0), std::min(to, duration)};
}

// ---- the tables --------------------------------------------------------------------------------

struct Bench {
  std::filesystem::path repository, data;
  bool json = false, baseline = true;
  unsigned seeds = 3;
  int people = 10;
  nlohmann::json all = nlohmann::json::object();

  std::filesystem::path maps() const { return repository / "joint_maps"; }
  std::filesystem::path reference(const std::string& name) const {
    return repository / "reference_motions" / name;
  }
  template <class... Args>
  void say(fmt::format_string<Args...> text, Args&&... args) const {
    if (!json) fmt::print(text, std::forward<Args>(args)...);
  }

  void add(const char* table, const std::string& method, const std::string& condition,
           const Metrics& m) {
    all[table].push_back(report(method, condition, m));
    if (json) return;
    if (std::string_view(table) == "warps") {
      print_warp(all[table].back());
    } else {
      print_performance(all[table].back());
    }
    std::fflush(stdout);
  }

  void warps(const std::vector<std::filesystem::path>& files);
  void repetitions();
  void people_table();
  void counts();
  void count(const std::string& name, const std::shared_ptr<const Reference>& reference,
             const std::string& source, const Motion& motion, int truth);
};

void Bench::warps(const std::vector<std::filesystem::path>& files) {
  std::vector<std::shared_ptr<const Reference>> references;
  for (const auto& file : files) {
    references.push_back(std::make_shared<const Reference>(load_reference(file, maps())));
  }
  const std::vector<Condition> conditions{
      {.name = "warp"},
      {.name = "white noise 3 deg", .noise_deg = 3.0},
      {.name = "1 Hz noise 3 deg", .noise_deg = 3.0, .noise_correlation = 1.0},
      {.name = "other body", .small_body = true},
      {.name = "20 % frames dropped", .dropped = 0.2},
      {.name = "stamps +-4 ms", .jitter = 0.004},
      {.name = "pauses of 1 s", .pauses = true},
      {.name = "skips of 0.8-1.4 s", .skips = true},
      {.name = "5 joints missing", .missing = true}};
  if (!json) print_warp_header();
  for (const Condition& condition : conditions) {
    Metrics aligner, oltw;
    for (std::size_t f = 0; f < references.size(); ++f) {
      const auto& reference = references[f];
      for (unsigned seed = 0; seed < seeds; ++seed) {
        const Trial trial =
            make_trial(reference->motion, condition, 1000 * static_cast<unsigned>(f) + seed);
        run(reference->motion, trial, aligner, aligner_for(reference));
        if (!baseline || seed > 0) continue;
        run(reference->motion, trial, oltw, oltw_for(reference->motion, trial.poses.size()));
      }
    }
    add("warps", "aligner", condition.name, aligner);
    if (baseline) add("warps", "OLTW", condition.name, oltw);
  }

  // Cost: one minute of reference.
  Motion minute = references.front()->motion;
  for (std::size_t f = 1; minute.poses.size() < 3600; f = (f + 1) % references.size()) {
    const auto& more = references[f]->motion.poses;
    minute.poses.insert(minute.poses.end(), more.begin(), more.end());
  }
  minute.poses.resize(3600, minute.poses.back());
  const auto reference = std::make_shared<const Reference>(make_reference("minute", minute));
  for (const std::size_t c : {std::size_t{2}, std::size_t{7}}) {
    Metrics cost;
    run(minute, make_trial(minute, conditions[c], 7), cost, aligner_for(reference));
    add("warps", "aligner", c == 2 ? "60 s reference, 1 Hz" : "60 s reference, skips", cost);
  }
}

void Bench::repetitions() {
  say("\nOne repetition in another of the same person, against offline time warping and at the "
      "limbs' highest speeds:\n");
  if (!json) print_performance_header();
  Metrics every_one, every_other, every_oltw;
  for (const Recording& recording : karate()) {
    const auto file = data / "bvh" / "cmu" / recording.file;
    if (!std::filesystem::exists(file)) {
      say("{}: not there\n", file.string());
      continue;
    }
    const Motion whole = read_canonical(file, maps());
    const Reference shipped = load_reference(reference(recording.technique), maps());
    const std::size_t n = recording.pairs.size();
    std::vector<Performance> performances;
    // The limb is the one that is fastest in the first repetition.
    std::array<std::optional<Joint>, 2> ends;
    for (std::size_t k = 0; k < n; ++k) {
      const auto [from, to] = window_of(recording, k, whole.duration());
      Performance p{resample(cut(whole, from, to), kReferenceRate), {}};
      const std::array<double, 2> noted{recording.pairs[k].first, recording.pairs[k].second};
      for (std::size_t e = 0; e < 2; ++e) {
        const Peak peak = peak_near(whole, noted[e], ends[e]);
        ends[e] = peak.end;
        p.peaks.push_back(peak.time - from);
      }
      performances.push_back(std::move(p));
    }
    const auto with = [&](const Motion& motion) {
      Reference r = shipped;
      r.motion = motion;
      r.band.clear();
      r.posture = {};
      return std::make_shared<const Reference>(std::move(r));
    };
    Metrics one, others, oltw;
    for (std::size_t j = 0; j < n; ++j) {
      std::vector<Motion> rest;
      std::size_t first = n;
      for (std::size_t i = 0; i < n; ++i) {
        if (i == j) continue;
        if (first == n) first = i;
        rest.push_back(performances[i].motion);
        const auto expert = with(performances[i].motion);
        for (Metrics* m : {&one, &every_one}) {
          run_performance(*expert, performances[i].peaks, performances[j], *m, aligner_for(expert));
        }
        if (!baseline) continue;
        for (Metrics* m : {&oltw, &every_oltw}) {
          run_performance(*expert, performances[i].peaks, performances[j], *m,
                          oltw_for(expert->motion, performances[j].motion.poses.size()));
        }
      }
      if (rest.size() < 2) continue;
      // Where the mean has its peaks: the first expert's, carried over.
      const auto mean = with(average_experts(rest, shipped.weight, kReferenceRate).motion);
      const auto path = warp_onto(performances[first].motion, mean->motion, shipped.weight);
      std::vector<double> peaks;
      for (const double t : performances[first].peaks) {
        const auto at = std::min(static_cast<std::size_t>(t * kReferenceRate), path.size() - 2);
        const double u = t * kReferenceRate - static_cast<double>(at);
        const double noted = ((1.0 - u) * path[at] + u * path[at + 1]) / kReferenceRate;
        peaks.push_back(peak_near(mean->motion, noted, ends[peaks.size()]).time);
      }
      for (Metrics* m : {&others, &every_other}) {
        run_performance(*mean, peaks, performances[j], *m, aligner_for(mean));
      }
    }
    add("repetitions", "aligner", recording.technique, one);
    if (others.frames > 0) {
      add("repetitions", "aligner, mean", recording.technique + " (mean)", others);
    }
    if (baseline) add("repetitions", "OLTW", recording.technique, oltw);
  }
  if (every_one.frames == 0) return;
  add("repetitions", "aligner", "all", every_one);
  add("repetitions", "aligner, mean", "all (mean)", every_other);
  if (baseline) add("repetitions", "OLTW", "all", every_oltw);
}

// UI-PRMD: correct executions by ten people, markers through the marker skeleton.
struct Exercise {
  const char* id;
  const char* name;
};
constexpr std::array<Exercise, 3> kExercises{
    {{"m01", "deep squat"}, {"m05", "sit to stand"}, {"m07", "shoulder abduction"}}};

void Bench::people_table() {
  const auto folder = data / "rehab" / "ui-prmd" / "markers_correct";
  if (!std::filesystem::exists(folder)) {
    say("\n{}: not there\n", folder.string());
    return;
  }
  const auto set = server::MarkerSet::load(repository / "marker_sets" / "plug_in_gait.toml");
  say("\nUI-PRMD, correct executions against offline time warping; reference of one repetition by "
      "the same person, by another, and the mean of three other people's:\n");
  if (!json) print_performance_header();
  for (const Exercise& exercise : kExercises) {
    std::vector<std::vector<Performance>> by_person;
    for (int person = 1; person <= people; ++person) {
      std::vector<Performance> repetitions;
      for (int repetition = 1; repetition <= 10; ++repetition) {
        const auto file = folder / fmt::format("{}_s{:02}_e{:02}_positions.txt.gz", exercise.id,
                                               person, repetition);
        if (!std::filesystem::exists(file)) continue;
        server::MarkerSource source(read_markers(file), set);
        Motion motion{source.skeleton(), source.rate_hz(), {}};
        for (StampedPose pose; source.next(pose) == server::Next::kPose;) {
          motion.poses.push_back(pose.pose);
        }
        // The left-handed do it mirrored.
        if (std::string_view(exercise.id) == "m07" && (person == 7 || person == 10)) {
          motion = mirrored(make_reference("left", motion)).motion;
        }
        repetitions.push_back({resample(motion, kReferenceRate), {}});
      }
      if (!repetitions.empty()) by_person.push_back(std::move(repetitions));
    }
    Metrics same, other, mean, oltw;
    const std::size_t n = by_person.size();
    for (std::size_t p = 0; p < n; ++p) {
      const Performance& learner = by_person[p][by_person[p].size() / 2];
      const auto follow = [&](const Motion& expert, Metrics& m, bool with_oltw) {
        const auto r = std::make_shared<const Reference>(make_reference(exercise.name, expert));
        run_performance(*r, {}, learner, m, aligner_for(r));
        if (with_oltw && baseline) {
          run_performance(*r, {}, learner, oltw, oltw_for(r->motion, learner.motion.poses.size()));
        }
      };
      follow(by_person[p].front().motion, same, false);
      for (std::size_t q = 0; q < n; ++q) {
        if (q != p) follow(by_person[q].front().motion, other, true);
      }
      if (n < 4) continue;
      std::vector<Motion> experts;
      for (std::size_t q = 1; q <= 3; ++q) experts.push_back(by_person[(p + q) % n].front().motion);
      const Reference average = make_reference(exercise.name, experts);
      follow(average.motion, mean, false);
      // All ten repetitions one after the other.
      Motion stream = by_person[p].front().motion;
      for (std::size_t k = 1; k < by_person[p].size(); ++k) {
        const auto& more = by_person[p][k].motion.poses;
        stream.poses.insert(stream.poses.end(), more.begin(), more.end());
      }
      count(exercise.name, std::make_shared<const Reference>(average),
            fmt::format("{} s{:02}", exercise.id, p + 1), stream,
            static_cast<int>(by_person[p].size()));
    }
    add("people", "aligner", std::string(exercise.name) + ", self", same);
    add("people", "aligner", std::string(exercise.name) + ", other", other);
    if (n >= 4) add("people", "aligner, mean", std::string(exercise.name) + ", 3 others", mean);
    if (baseline) add("people", "OLTW", std::string(exercise.name) + ", other", oltw);
  }
  int right = 0, total = 0, counted = 0, truth = 0;
  for (const auto& c : all["counts"]) {
    if (c["source"].get<std::string>().front() != 'm') continue;
    ++total;
    counted += c["counted"].get<int>();
    truth += c["truth"].get<int>();
    if (c["counted"] == c["truth"]) ++right;
  }
  if (total > 0) {
    say("repetitions counted in mean references of three others: {} of {}; right in {} of {} "
        "series\n",
        counted, truth, right, total);
  }
}

void Bench::count(const std::string& name, const std::shared_ptr<const Reference>& reference,
                  const std::string& source, const Motion& motion, int truth) {
  const Motion stream = resample(motion, kLearnerRate);
  Aligner aligner(reference);
  int counted = 0;
  Phase before = Phase::kWaiting;
  for (std::size_t i = 0; i < stream.poses.size(); ++i) {
    const double t = static_cast<double>(i) / kLearnerRate;
    const auto e = aligner.update(static_cast<std::int64_t>((t + 1.0) * 1e9), stream.poses[i]);
    if (e.phase == Phase::kFinished && before != Phase::kFinished) ++counted;
    before = e.phase;
  }
  all["counts"].push_back(
      {{"reference", name}, {"source", source}, {"counted", counted}, {"truth", truth}});
}

void Bench::counts() {
  say("\nRepetitions counted in whole recordings (truth in brackets where it is not 0):\n");
  struct Source {
    std::string file;
    std::map<std::string, int> truth;
  };
  const std::vector<Source> sources{{"135_05_gedanbarai", {{"low_block", 4}}},
                                    {"135_07_mawashigeri", {{"roundhouse_kick", 2}}},
                                    {"135_09_oiduki", {{"stepping_punch", 4}}},
                                    {"135_10_syutouuke", {{"knife_hand_block", 4}}},
                                    {"14_14", {{"jumping_jack", 3}, {"squat", 2}}},
                                    {"13_26", {}},
                                    {"131_01", {}}};
  std::vector<std::pair<std::string, Motion>> motions;
  for (const Source& source : sources) {
    const auto file = data / "bvh" / "cmu" / (source.file + ".bvh");
    if (!std::filesystem::exists(file)) {
      say("{}: not there\n", file.string());
      return;
    }
    motions.emplace_back(source.file, read_canonical(file, maps()));
  }
  std::string header = fmt::format("{:<18}", "reference");
  for (const auto& [file, motion] : motions) header += fmt::format(" {:>18}", file);
  say("{}\n", header);
  for (const char* name : {"low_block", "roundhouse_kick", "stepping_punch", "knife_hand_block",
                           "jumping_jack", "squat", "wave_hello"}) {
    const auto r = std::make_shared<const Reference>(load_reference(reference(name), maps()));
    std::string row = fmt::format("{:<18}", name);
    for (std::size_t k = 0; k < motions.size(); ++k) {
      const auto expected = sources[k].truth.find(name);
      const int truth = expected == sources[k].truth.end() ? 0 : expected->second;
      count(name, r, motions[k].first, motions[k].second, truth);
      const auto& counted = all["counts"].back()["counted"];
      row += fmt::format(" {:>18}", truth > 0 ? fmt::format("{} ({})", counted.get<int>(), truth)
                                              : fmt::format("{}", counted.get<int>()));
    }
    say("{}\n", row);
  }
}

}  // namespace

int main(int argc, char** argv) {
  namespace fs = std::filesystem;
  CLI::App app{
      "Alignment: known time warps, other repetitions, other people, counts, and its cost"};
  Bench bench;
  bench.repository = SECONDSKIN_SOURCE_DIR;
  bench.data = bench.repository / ".." / "shared" / "data";
  std::vector<fs::path> files;
  std::vector<std::string> tables{"warps", "repetitions", "counts", "people"};
  app.add_flag("--json", bench.json, "print JSON");
  app.add_flag("--baseline,!--no-baseline", bench.baseline, "run Dixon's OLTW as well");
  app.add_option("--seeds", bench.seeds, "warps a motion and condition");
  app.add_option("--people", bench.people, "people of UI-PRMD, 1 to 10")->check(CLI::Range(1, 10));
  app.add_option("--table", tables, "which tables")
      ->check(CLI::IsMember({"warps", "repetitions", "counts", "people"}));
  app.add_option("--repository", bench.repository, "where reference_motions and joint_maps are");
  app.add_option("--data", bench.data, "the recordings that are not shipped");
  app.add_option("files", files, "motion files to warp instead of the reference motions' learners");
  CLI11_PARSE(app, argc, argv);
  if (files.empty()) {
    for (const auto& entry : fs::directory_iterator(bench.repository / "reference_motions")) {
      if (fs::exists(entry.path() / "learner.bvh")) files.push_back(entry.path() / "learner.bvh");
    }
    std::sort(files.begin(), files.end());
  }
  for (const std::string& table : tables) {
    if (table == "warps") bench.warps(files);
    if (table == "repetitions") bench.repetitions();
    if (table == "counts") bench.counts();
    if (table == "people") bench.people_table();
  }
  if (bench.json) fmt::print("{}\n", bench.all.dump(2));
  return 0;
}
