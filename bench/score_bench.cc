// Does the total tell right executions from wrong ones? The protocol of UI-PRMD's authors on three
// of its exercises: every execution of a person is scored against a reference made of other
// people's correct ones, next to plain dynamic time warping of joint angles. docs/scoring.md quotes
// the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "coach/score/offline.h"
#include "motion/ui_prmd.h"
#include "server/markers/body_fit.h"
#include "server/markers/marker_body.h"
#include "server/markers/marker_set.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::coach;

constexpr int kPeople = 10;
constexpr int kRepetitions = 10;

struct Exercise {
  std::string code, name;
  std::vector<int> left_handed;  // people; the others use the right (data README)
  bool one_sided;                // either side is as good
};

struct Execution {
  int person = 0;
  bool correct = false;
  Motion motion;
};

// All of one exercise, markers to poses; the body is fitted to a person's first correct execution.
std::vector<Execution> read_executions(const std::filesystem::path& folder,
                                       const std::filesystem::path& marker_sets,
                                       const std::string& code) {
  std::vector<Execution> all;
  for (int person = 1; person <= kPeople; ++person) {
    std::unique_ptr<server::MarkerBody> body;
    for (const bool correct : {true, false}) {
      for (int repetition = 1; repetition <= kRepetitions; ++repetition) {
        const auto file = folder / (correct ? "markers_correct" : "markers_incorrect") /
                          fmt::format("{}_s{:02}_e{:02}_positions{}.txt.gz", code, person,
                                      repetition, correct ? "" : "_inc");
        if (!std::filesystem::exists(file)) continue;
        const MarkerMotion markers = read_ui_prmd_markers(file);
        if (!body) {
          const auto set = server::MarkerSet::choose(marker_sets, markers.names);
          body = std::make_unique<server::MarkerBody>(server::calibrate_body(set, markers).body);
        }
        server::BodyFit fit(*body);
        Motion motion{fit.skeleton(), markers.rate_hz, {}};
        Pose pose(kJointCount);
        for (const MarkerFrame& frame : markers.frames) {
          (void)fit.update(frame, 1.0 / markers.rate_hz, pose);
          motion.poses.push_back(pose);
        }
        all.push_back({person, correct, resample(motion, kReferenceRate)});
      }
    }
  }
  return all;
}

Motion mirrored_motion(const Motion& motion) {
  return mirrored(make_reference("one", motion)).motion;
}

// How well values tell correct (low) from incorrect (high) executions.
struct Separation {
  double degree = 0.0, area = 0.0;
};

Separation separation(const std::vector<double>& correct, const std::vector<double>& incorrect) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const auto* values : {&correct, &incorrect}) {
    for (const double v : *values) {
      low = std::min(low, v);
      high = std::max(high, v);
    }
  }
  const auto scaled = [&](double v) {
    return high > low ? 1.0 + 19.0 * (v - low) / (high - low) : 1.0;
  };
  Separation sum;
  for (const double c : correct) {
    for (const double i : incorrect) {
      sum.degree += (scaled(i) - scaled(c)) / (scaled(i) + scaled(c));
      sum.area += i > c ? 1.0 : i < c ? 0.0 : 0.5;
    }
  }
  const auto pairs = static_cast<double>(correct.size() * incorrect.size());
  return pairs > 0.0 ? Separation{sum.degree / pairs, sum.area / pairs} : Separation{};
}

// Values of all executions; NaN leaves one out.
struct Values {
  std::string name;
  std::vector<double> of;

  Separation among(const std::vector<Execution>& all, std::optional<int> person) const {
    std::vector<double> correct, incorrect;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (std::isnan(of[i]) || (person && all[i].person != *person)) continue;
      (all[i].correct ? correct : incorrect).push_back(of[i]);
    }
    return separation(correct, incorrect);
  }
  Separation between(const std::vector<Execution>& all) const { return among(all, std::nullopt); }
  Separation within(const std::vector<Execution>& all) const {
    Separation mean;
    for (int p = 1; p <= kPeople; ++p) {
      const Separation own = among(all, p);
      mean.degree += own.degree / kPeople;
      mean.area += own.area / kPeople;
    }
    return mean;
  }
};

// ---- the scorer

std::vector<StampedPose> stamped(const Motion& motion) {
  std::vector<StampedPose> poses;
  for (std::size_t i = 0; i < motion.poses.size(); ++i) {
    const double t = 1.0 + static_cast<double>(i) / motion.rate_hz;
    poses.push_back({i, static_cast<std::int64_t>(t * 1e9), motion.poses[i]});
  }
  return poses;
}

struct Options {
  int experts = 2;  // correct executions of each of the other people in a reference
  bool online = false;
};

std::shared_ptr<const Reference> reference_of(const Exercise& exercise,
                                              const std::vector<Motion>& experts) {
  Reference reference = make_reference(exercise.name, experts);
  reference.either_side = exercise.one_sided;
  return std::make_shared<const Reference>(std::move(reference));
}

// 100 less the total, and what each criterion loses, against other people's executions.
std::vector<Values> scored_by_others(const Exercise& exercise, const std::vector<Execution>& all,
                                     const Options& options) {
  std::vector<Values> values{{"score", {}}, {"depth", {}}, {"trunk", {}},    {"head", {}},
                             {"legs", {}},  {"arms", {}},  {"symmetry", {}}, {"joints", {}}};
  for (Values& v : values) v.of.assign(all.size(), std::numeric_limits<double>::quiet_NaN());
  for (int person = 1; person <= kPeople; ++person) {
    std::vector<Motion> experts;
    for (int other = 1; other <= kPeople; ++other) {
      if (other == person) continue;
      std::vector<const Execution*> own;
      for (const Execution& e : all) {
        if (e.person == other && e.correct) own.push_back(&e);
      }
      const bool left = std::count(exercise.left_handed.begin(), exercise.left_handed.end(), other);
      for (int k = 0; k < options.experts && !own.empty(); ++k) {
        const std::size_t at = own.size() * static_cast<std::size_t>(2 * k + 1) /
                               static_cast<std::size_t>(2 * options.experts);
        experts.push_back(left ? mirrored_motion(own[at]->motion) : own[at]->motion);
      }
    }
    const auto reference = reference_of(exercise, experts);
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i].person != person) continue;
      const auto poses = stamped(all[i].motion);
      const OfflineScore score =
          options.online ? score_recording(reference, poses) : score_whole(reference, poses);
      if (score.repetitions.size() != 1) continue;
      values[0].of[i] = 100.0 - score.repetitions[0].total;
      for (std::size_t c = 0; c <= kCriterionCount; ++c) {
        if (score.repetitions[0].lost[c]) values[c + 1].of[i] = *score.repetitions[0].lost[c];
      }
    }
  }
  return values;
}

// Against the person's own first correct executions; those are left out of the count.
Values scored_by_own(const Exercise& exercise, const std::vector<Execution>& all) {
  constexpr std::size_t kOwn = 3;
  Values values{"score, own",
                std::vector<double>(all.size(), std::numeric_limits<double>::quiet_NaN())};
  for (int person = 1; person <= kPeople; ++person) {
    std::vector<Motion> experts;
    std::shared_ptr<const Reference> reference;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i].person != person) continue;
      if (experts.size() < kOwn) {
        experts.push_back(all[i].motion);
        continue;
      }
      if (!reference) reference = reference_of(exercise, experts);
      const OfflineScore score = score_whole(reference, stamped(all[i].motion));
      if (!score.repetitions.empty()) values.of[i] = 100.0 - score.repetitions[0].total;
    }
  }
  return values;
}

// ---- plain dynamic time warping of all anatomical joint angles

using Angles = std::vector<std::array<float, 3 * kJointCount>>;

Angles angles_of(const Motion& motion) {
  Angles angles;
  for (const Pose& pose : resample(motion, 20.0).poses) {
    auto& frame = angles.emplace_back();
    for (std::size_t j = 0; j < kJointCount; ++j) {
      JointAngles a = joint_angles(static_cast<Joint>(j), pose.q_PB[j]);
      if (j == index(Joint::kPelvis)) a[2] = 0.0;  // the heading
      for (std::size_t m = 0; m < 3; ++m) frame[3 * j + m] = static_cast<float>(a[m]);
    }
  }
  return angles;
}

double time_warping_distance(const Angles& a, const Angles& b) {
  std::vector<double> cost(b.size() + 1, std::numeric_limits<double>::infinity()), above = cost;
  cost[0] = 0.0;
  for (const auto& x : a) {
    above.swap(cost);
    cost[0] = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < b.size(); ++k) {
      float square = 0.0F;
      for (std::size_t n = 0; n < x.size(); ++n) square += (x[n] - b[k][n]) * (x[n] - b[k][n]);
      cost[k + 1] = std::sqrt(square) + std::min({above[k], above[k + 1], cost[k]});
    }
  }
  return cost.back();
}

// A repetition's mean distance to all other correct ones, of all people or of its own.
std::array<Values, 2> warped(const Exercise& exercise, const std::vector<Execution>& all) {
  std::vector<Angles> angles;
  for (const Execution& e : all) {
    const bool left =
        std::count(exercise.left_handed.begin(), exercise.left_handed.end(), e.person);
    angles.push_back(angles_of(left ? mirrored_motion(e.motion) : e.motion));
  }
  std::array<Values, 2> values{{{"DTW", {}}, {"DTW", {}}}};
  for (std::size_t i = 0; i < all.size(); ++i) {
    double sum = 0.0, own = 0.0, count = 0.0, own_count = 0.0;
    for (std::size_t k = 0; k < all.size(); ++k) {
      if (k == i || !all[k].correct) continue;
      const double d = time_warping_distance(angles[i], angles[k]);
      sum += d;
      count += 1.0;
      if (all[k].person != all[i].person) continue;
      own += d;
      own_count += 1.0;
    }
    values[0].of.push_back(sum / count);
    values[1].of.push_back(own / own_count);
  }
  return values;
}

// ---- what a frame costs

double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Cost {
  double p50 = 0.0, p99 = 0.0, last = 0.0;  // [s]; last: the frame that ends a repetition
};

Cost cost_of(const std::shared_ptr<const Reference>& reference, const Motion& motion) {
  RepetitionScorer scorer(reference);
  JointVectors error = zero_vectors();
  std::vector<double> costs, ends;
  std::int64_t stamp_ns = 1'000'000'000;
  for (int round = 0; round < 20; ++round) {
    for (std::size_t i = 0; i < motion.poses.size(); ++i) {
      const double time = static_cast<double>(i) / static_cast<double>(motion.poses.size()) *
                          reference->motion.duration();
      joint_errors(*reference, time, motion.poses[i], error);
      const bool end = i + 1 == motion.poses.size();
      const double begin = cpu_time();
      const auto score =
          scorer.update(stamp_ns += 16'000'000, motion.poses[i],
                        {time, 1.0, 1.0, end ? Phase::kFinished : Phase::kMoving, 1}, error, 0);
      (score ? ends : costs).push_back(cpu_time() - begin);
    }
  }
  std::sort(costs.begin(), costs.end());
  std::sort(ends.begin(), ends.end());
  return {costs[costs.size() / 2], costs[costs.size() * 99 / 100], ends[ends.size() / 2]};
}

void print(nlohmann::json& report, const std::string& method, const Separation& between,
           const std::optional<Separation>& within, bool quiet) {
  const auto json_of = [](const Separation& s) {
    return nlohmann::json{{"separation_degree", s.degree}, {"auc", s.area}};
  };
  report[method] = {{"between", json_of(between)}};
  if (within) report[method]["within"] = json_of(*within);
  if (quiet) return;
  fmt::print("  {:<14} {:8.3f} {:8.3f}", method, between.degree, between.area);
  if (within) fmt::print(" {:10.3f} {:8.3f}", within->degree, within->area);
  fmt::print("\n");
}

}  // namespace

int main(int argc, char** argv) try {
  const std::filesystem::path root = SECONDSKIN_SOURCE_DIR;
  std::filesystem::path data = root.parent_path() / "shared" / "data";
  Options options;
  bool json = false, no_warping = false;
  std::string only;
  CLI::App app{"Right against wrong executions of exercises: separation of the scores"};
  app.add_option("--data", data, "recordings; UI-PRMD in rehab/ui-prmd")->capture_default_str();
  app.add_option("--experts", options.experts, "correct executions of each other person")
      ->check(CLI::Range(1, kRepetitions))
      ->capture_default_str();
  app.add_option("--only", only, "one exercise: m01, m05 or m07");
  app.add_flag("--online", options.online,
               "align live; those not found to be one repetition are left out");
  app.add_flag("--no-dtw", no_warping, "without the baseline");
  app.add_flag("--json", json, "as JSON");
  CLI11_PARSE(app, argc, argv);

  const std::filesystem::path folder = data / "rehab" / "ui-prmd";
  if (!std::filesystem::exists(folder)) {
    fmt::print("{} is not there: nothing to score\n", folder.string());
    return 0;
  }
  const std::vector<Exercise> exercises{{"m01", "deep squat", {}, false},
                                        {"m05", "sit to stand", {}, false},
                                        {"m07", "shoulder abduction", {7, 10}, true}};
  nlohmann::json all = nlohmann::json::object();
  Separation mean;
  double count = 0.0;
  for (const Exercise& exercise : exercises) {
    if (!only.empty() && exercise.code != only) continue;
    const auto executions = read_executions(folder, root / "marker_sets", exercise.code);
    if (executions.empty()) throw std::runtime_error(fmt::format("no files of {}", exercise.code));
    nlohmann::json& report = all[exercise.code];
    if (!json) {
      fmt::print("{} {}: {} executions    between people     within a person\n", exercise.code,
                 exercise.name, executions.size());
      fmt::print("  {:<14} {:>8} {:>8} {:>10} {:>8}\n", "", "degree", "AUC", "degree", "AUC");
    }
    const auto scores = scored_by_others(exercise, executions, options);
    const auto missing = std::count_if(scores[0].of.begin(), scores[0].of.end(),
                                       [](double v) { return std::isnan(v); });
    for (const Values& v : scores) {
      print(report, v.name, v.between(executions), v.within(executions), json);
    }
    mean.degree += scores[0].between(executions).degree;
    mean.area += scores[0].between(executions).area;
    count += 1.0;
    const Values own = scored_by_own(exercise, executions);
    print(report, own.name, own.between(executions), own.within(executions), json);
    if (!no_warping) {
      const auto [others, same] = warped(exercise, executions);
      print(report, "DTW", others.between(executions), same.within(executions), json);
    }
    const auto reference = reference_of(exercise, {executions.front().motion});
    const Cost cost = cost_of(reference, executions.back().motion);
    report["not_one_repetition"] = missing;
    report["cost_us"] = {
        {"p50", 1e6 * cost.p50}, {"p99", 1e6 * cost.p99}, {"end", 1e6 * cost.last}};
    if (!json) {
      fmt::print(
          "  left out {}; a frame costs {:.1f} us (p99 {:.1f}), a repetition's end {:.0f} us\n\n",
          missing, 1e6 * cost.p50, 1e6 * cost.p99, 1e6 * cost.last);
      std::fflush(stdout);
    }
  }
  if (count > 0.0) {
    all["mean"] = {{"separation_degree", mean.degree / count}, {"auc", mean.area / count}};
    if (!json) {
      fmt::print("mean of the scores between people: degree {:.3f}, AUC {:.3f}\n",
                 mean.degree / count, mean.area / count);
    }
  }
  if (json) fmt::print("{}\n", all.dump(2));
  return 0;
} catch (const std::exception& e) {
  fmt::print(stderr, "score_bench: {}\n", e.what());
  return 1;
}
