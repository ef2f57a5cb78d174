// How far is the aligner from the truth, and what does it cost? Real motions under known time
// warps, with what goes wrong in practice, next to Dixon's online time warping (S. Dixon, "Live
// tracking of musical performances using on-line time warping", DAFx 2005). docs/alignment.md
// quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "coach/align/aligner.h"
#include "motion/rotation.h"

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
  std::vector<double> cost;        // of each frame [s]
  std::vector<double> recovery;    // [s]
  std::vector<double> still_pose;  // pose error on the other frames [rad]
  std::size_t moving = 0, followed = 0, lost = 0, frames = 0;
};

double quantile(std::vector<double> v, double q) {
  if (v.empty()) return 0.0;
  const auto at = static_cast<std::size_t>(q * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(at), v.end());
  return v[at];
}

void run(const Motion& reference, const Trial& trial, Metrics& m,
         const std::function<std::pair<double, Phase>(std::int64_t, const Pose&)>& follow) {
  std::size_t event = 0;
  double event_start = -1.0;
  Pose there(kJointCount);
  for (std::size_t i = 0; i < trial.poses.size(); ++i) {
    const double begin = cpu_time();
    const auto [time, phase] = follow(trial.stamps_ns[i], trial.poses[i]);
    m.cost.push_back(cpu_time() - begin);
    const double truth = trial.reference_time[i];
    const double t = static_cast<double>(trial.stamps_ns[i]) * 1e-9 - 1.0;
    ++m.frames;
    const bool inside = truth > 0.5 && truth < reference.duration() - 0.2;
    if (!inside) continue;
    if (phase == Phase::kLost) ++m.lost;
    const double error = std::fabs(time - truth);
    while (event < trial.events.size() && t >= trial.events[event]) {
      if (event_start >= 0.0) m.recovery.push_back(t - event_start);
      event_start = trial.events[event++];
    }
    if (event_start >= 0.0 && error < 0.1) {
      m.recovery.push_back(t - event_start);
      event_start = -1.0;
    }
    if (trial.moving[i]) {
      ++m.moving;
      if (phase == Phase::kMoving || phase == Phase::kPaused) {
        ++m.followed;
        m.error.push_back(error);
      }
    } else {
      sample(reference, time, there);
      Pose truth_pose(kJointCount);
      sample(reference, truth, truth_pose);
      m.still_pose.push_back(rms_distance(there, truth_pose));
    }
  }
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
          {"still_pose_p95_deg", quantile(m.still_pose, 0.95) / kDegree},
          {"cost_p50_us", 1e6 * quantile(m.cost, 0.5)},
          {"cost_p99_us", 1e6 * quantile(m.cost, 0.99)}};
}

void print(const nlohmann::json& r) {
  fmt::print(
      "{:<8} {:<22} {:>6.1f} {:>6.1f} {:>7.1f} {:>6.1f} {:>6.1f} {:>6.1f} {:>6.1f} {:>5.1f} "
      "{:>6.1f} "
      "{:>7.0f} {:>6.1f} {:>6.1f} {:>7.1f}\n",
      r["method"].get<std::string>(), r["condition"].get<std::string>(),
      r["median_ms"].get<double>(), r["mean_ms"].get<double>(), r["p95_ms"].get<double>(),
      r["within_50_ms"].get<double>(), r["within_100_ms"].get<double>(),
      r["within_250_ms"].get<double>(), r["within_500_ms"].get<double>(), r["lost"].get<double>(),
      r["coverage"].get<double>(), r["recovery_p95_ms"].get<double>(),
      r["still_pose_p95_deg"].get<double>(), r["cost_p50_us"].get<double>(),
      r["cost_p99_us"].get<double>());
}

}  // namespace

int main(int argc, char** argv) {
  namespace fs = std::filesystem;
  CLI::App app{"Alignment against known time warps of real motions, and its cost"};
  fs::path repository = SECONDSKIN_SOURCE_DIR;
  bool json = false, baseline = true;
  unsigned seeds = 3;
  std::vector<fs::path> files;
  app.add_flag("--json", json, "print JSON");
  app.add_flag("--baseline,!--no-baseline", baseline, "run Dixon's OLTW as well");
  app.add_option("--seeds", seeds, "warps a motion and condition");
  app.add_option("--repository", repository, "where reference_motions and joint_maps are");
  app.add_option("files", files, "motion files instead of the reference motions' recordings");
  CLI11_PARSE(app, argc, argv);
  const fs::path maps = repository / "joint_maps";
  if (files.empty()) {
    for (const auto& entry : fs::directory_iterator(repository / "reference_motions")) {
      if (fs::exists(entry.path() / "learner.bvh")) files.push_back(entry.path() / "learner.bvh");
    }
    std::sort(files.begin(), files.end());
  }
  std::vector<std::shared_ptr<const Reference>> references;
  for (const fs::path& file : files) {
    references.push_back(std::make_shared<const Reference>(load_reference(file, maps)));
  }

  std::vector<Condition> conditions(9);
  conditions[0] = {.name = "warp"};
  conditions[1] = {.name = "white noise 3 deg", .noise_deg = 3.0};
  conditions[2] = {.name = "1 Hz noise 3 deg", .noise_deg = 3.0, .noise_correlation = 1.0};
  conditions[3] = {.name = "other body", .small_body = true};
  conditions[4] = {.name = "20 % frames dropped", .dropped = 0.2};
  conditions[5] = {.name = "stamps +-4 ms", .jitter = 0.004};
  conditions[6] = {.name = "pauses of 1 s", .pauses = true};
  conditions[7] = {.name = "skips of 0.8-1.4 s", .skips = true};
  conditions[8] = {.name = "5 joints missing", .missing = true};

  nlohmann::json all = nlohmann::json::array();
  if (!json) {
    fmt::print(
        "{:<8} {:<22} {:>6} {:>6} {:>7} {:>6} {:>6} {:>6} {:>6} {:>5} {:>6} {:>7} {:>6} {:>6} "
        "{:>7}\n",
        "method", "condition", "median", "mean", "p95 ms", "<50", "<100", "<250", "<500%", "lost",
        "cover", "recov95", "still", "p50 us", "p99 us");
  }
  const auto add = [&](const std::string& method, const std::string& condition, const Metrics& m) {
    all.push_back(report(method, condition, m));
    if (!json) print(all.back());
  };
  for (const Condition& condition : conditions) {
    Metrics aligner_metrics, oltw_metrics;
    for (std::size_t f = 0; f < references.size(); ++f) {
      const auto& reference = references[f];
      for (unsigned seed = 0; seed < seeds; ++seed) {
        const Trial trial =
            make_trial(reference->motion, condition, 1000 * static_cast<unsigned>(f) + seed);
        Aligner aligner(reference);
        run(reference->motion, trial, aligner_metrics, [&](std::int64_t stamp, const Pose& pose) {
          const AlignmentEstimate e = aligner.update(stamp, pose);
          return std::pair{e.reference_time, e.phase};
        });
        if (!baseline || seed > 0) continue;
        OnlineTimeWarping oltw(reference->motion, trial.poses.size());
        run(reference->motion, trial, oltw_metrics, [&](std::int64_t, const Pose& pose) {
          return std::pair{oltw.update(pose), Phase::kMoving};
        });
      }
    }
    add("aligner", condition.name, aligner_metrics);
    if (baseline) add("OLTW", condition.name, oltw_metrics);
  }

  // Cost: one minute of reference.
  Motion minute = references.front()->motion;
  for (std::size_t f = 1; minute.poses.size() < 3600; f = (f + 1) % references.size()) {
    const auto& more = references[f]->motion.poses;
    minute.poses.insert(minute.poses.end(), more.begin(), more.end());
  }
  minute.poses.resize(3600, minute.poses.back());
  const auto reference = std::make_shared<const Reference>(make_reference("minute", minute));
  Metrics cost;
  const Trial trial = make_trial(minute, conditions[2], 7);
  Aligner aligner(reference);
  run(minute, trial, cost, [&](std::int64_t stamp, const Pose& pose) {
    const AlignmentEstimate e = aligner.update(stamp, pose);
    return std::pair{e.reference_time, e.phase};
  });
  add("aligner", "60 s reference", cost);
  if (json) fmt::print("{}\n", all.dump(2));
  return 0;
}
