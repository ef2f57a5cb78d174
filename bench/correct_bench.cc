// How long does a correction take, and where does the time go? A learner who does a real reference
// motion with slowly changing errors, solved as in a live session: at the coach's 15 problems a
// second, at every frame of a 62.5 Hz source, and cold. docs/correction.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "bench/correction_trials.h"
#include "coach/correct/correction.h"
#include "coach/correct/correction_model.h"
#include "coach/correct/joint_selection.h"
#include "motion/rotation.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::coach;
using Clock = std::chrono::steady_clock;

constexpr double kDegree = std::numbers::pi / 180.0;

double thread_cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// The errors of one learner: every joint strays a little, some joints a lot.
class Learner {
 public:
  Learner(const Reference& reference, double stray, double mistake, unsigned seed)
      : reference_(reference), now_(kJointCount), next_(kJointCount) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> phase(0.0, 2.0 * std::numbers::pi);
    std::uniform_real_distribution<double> frequency(0.1, 0.6);
    std::vector<std::size_t> joints;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (reference.weight[j] > 0.0) joints.push_back(j);
      for (int k = 0; k < 3; ++k) {
        phase_[j][k] = phase(random);
        frequency_[j][k] = frequency(random);
        amount_[j] = stray;
      }
    }
    std::shuffle(joints.begin(), joints.end(), random);
    for (std::size_t n = 0; n < std::min<std::size_t>(3, joints.size()); ++n) {
      amount_[joints[n]] = mistake;
    }
  }

  CorrectionProblem at(double t) {
    const double duration = reference_.motion.duration();
    const double reference_time = duration > 0.0 ? std::fmod(t, duration) : 0.0;
    constexpr double kStep = 1.0 / 62.5;
    pose(reference_time, t, now_);
    pose(reference_time + kStep, t + kStep, next_);
    CorrectionProblem problem;
    problem.reference_time = reference_time;
    problem.learner = now_;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      problem.velocity[j] = rotation_vector(now_.q_PB[j].conjugate() * next_.q_PB[j]) / kStep;
    }
    return problem;
  }

 private:
  void pose(double reference_time, double t, Pose& out) const {
    sample(reference_.motion, reference_time, out);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      Eigen::Vector3d e;
      for (int k = 0; k < 3; ++k) {
        e[k] = amount_[j] * std::sin(2.0 * std::numbers::pi * frequency_[j][k] * t + phase_[j][k]);
      }
      out.q_PB[j] = out.q_PB[j] * quaternion_from(e);
    }
  }

  const Reference& reference_;
  Pose now_, next_;
  std::array<Eigen::Vector3d, kJointCount> phase_, frequency_;
  std::array<double, kJointCount> amount_{};
};

struct Series {
  std::string name;
  std::vector<double> wall, cpu;
  std::vector<std::uint32_t> iterations;
  std::array<std::size_t, 4> status{};
  std::size_t asked = 0;

  void add(const CorrectionResult& result, double cpu_time) {
    wall.push_back(result.solve_time);
    cpu.push_back(cpu_time);
    iterations.push_back(result.iterations);
    ++status[static_cast<std::size_t>(result.status)];
    for (const Eigen::Vector3d& v : result.target) asked += v.isZero() ? 0 : 1;
  }
};

template <typename T>
double quantile(std::vector<T> values, double q) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return static_cast<double>(
      values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1) + 0.5)]);
}

nlohmann::json report(const Series& s) {
  const auto n = static_cast<double>(s.wall.size());
  const auto times = [](const std::vector<double>& t) {
    return nlohmann::json{{"p50", 1e3 * quantile(t, 0.5)},
                          {"p90", 1e3 * quantile(t, 0.9)},
                          {"p99", 1e3 * quantile(t, 0.99)},
                          {"max", 1e3 * quantile(t, 1.0)}};
  };
  std::array<std::size_t, 16> histogram{};
  for (const double t : s.wall) {
    ++histogram[static_cast<std::size_t>(std::clamp(1e3 * t, 0.0, 15.0))];
  }
  return {{"name", s.name},
          {"solves", s.wall.size()},
          {"wall_ms", times(s.wall)},
          {"cpu_ms", times(s.cpu)},
          {"iterations",
           {{"p50", quantile(s.iterations, 0.5)},
            {"p99", quantile(s.iterations, 0.99)},
            {"max", quantile(s.iterations, 1.0)}}},
          {"converged", static_cast<double>(s.status[1]) / n},
          {"deadline", static_cast<double>(s.status[2]) / n},
          {"fallback", static_cast<double>(s.status[3]) / n},
          {"joints_asked", static_cast<double>(s.asked) / n},
          {"histogram_ms", histogram}};
}

double mean_time(const std::function<void(int)>& work) {
  constexpr int kTimes = 2000;
  const double start = thread_cpu_time();
  for (int i = 0; i < kTimes; ++i) work(i);
  return (thread_cpu_time() - start) / kTimes;
}

// Ways to choose two joints. All have the best amounts for their choice, from the same solver.
enum Choice { kOurs, kLargestError, kLargestAngle, kOfAll, kBestPair, kAllJoints, kChoices };
constexpr std::array<const char*, kChoices> kChoiceNames{
    "ours",
    "two largest weighted errors beyond tolerance",
    "two largest angles",
    "two of most benefit in the solution for all joints",
    "best of all pairs",
    "all joints"};

// Sums of error before and after, by measure.
struct Removed {
  double task = 0.0, task_left = 0.0, whole = 0.0, whole_left = 0.0;
};
struct Cluster {
  std::array<Removed, kChoices> removed{};
};

struct Comparison {
  std::string name, unit;
  std::size_t problems = 0, same_pair = 0, asked = 0;
  std::map<std::string, Cluster> clusters;
};

// delta from what was asked, so that what was asked is what counts.
std::vector<double> asked_delta(const CorrectionModel& model, const CorrectionProblem& problem,
                                const CorrectionResult& result) {
  std::vector<double> delta(model.size(), 0.0);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (result.target[j].isZero()) continue;
    const auto joint = static_cast<Joint>(j);
    Eigen::Quaterniond q = problem.learner.q_PB[j].normalized();
    if (joint == Joint::kPelvis) {
      JointAngles angles = joint_angles(joint, q);
      angles[static_cast<std::size_t>(Movement::kRotation)] = 0.0;
      q = joint_rotation(joint, angles);
    }
    const JointAngles before = joint_angles(joint, q);
    const JointAngles after = joint_angles(joint, q * quaternion_from(result.target[j]));
    for (std::size_t m = 0; m < 3; ++m) {
      const int i = model.freedoms_of(j)[m];
      if (i >= 0) {
        delta[static_cast<std::size_t>(i)] =
            std::remainder(after[m] - before[m], 2.0 * std::numbers::pi);
      }
    }
  }
  return delta;
}

Comparison compare(const TrialSet& set, bool exhaustive) {
  constexpr SolveLimit kNoHurry{.deadline = 10.0, .iterations = {}};
  Comparison comparison{set.name, set.unit, 0, 0, 0, {}};
  std::shared_ptr<const Reference> last;
  std::unique_ptr<CorrectionSolver> ours, free;
  std::unique_ptr<CorrectionModel> model;
  std::unique_ptr<JointSelection> every;
  for (const CorrectionTrial& trial : set.trials) {
    if (trial.reference != last) {
      last = trial.reference;
      const CorrectionOptions any{.sparsity = 0.0, .max_joints = kJointCount};
      ours = std::make_unique<CorrectionSolver>(trial.reference, trial.learner);
      free = std::make_unique<CorrectionSolver>(trial.reference, trial.learner, any);
      model = std::make_unique<CorrectionModel>(trial.reference, trial.learner, any);
      every = std::make_unique<JointSelection>(*model);
    }
    Cluster& cluster = comparison.clusters[trial.cluster];
    for (const CorrectionProblem& given : trial.problems) {
      if (!model->pose(given) || !model->has_error()) continue;
      ++comparison.problems;
      const std::vector<double> none(model->size(), 0.0);
      const double task = model->task_error(none), whole = model->error(none);
      const auto count = [&](Choice choice, const CorrectionResult& result) {
        const std::vector<double> delta = asked_delta(*model, given, result);
        Removed& removed = cluster.removed[choice];
        removed.task += task;
        removed.whole += whole;
        removed.task_left += model->task_error(delta);
        removed.whole_left += model->error(delta);
      };
      const auto only = [&](const JointSet& joints) {
        CorrectionProblem problem = given;
        problem.askable = joints;
        return free->solve(problem, kNoHurry);
      };
      const auto two_largest = [&](const std::array<double, kJointCount>& size) {
        JointSet two;
        for (int n = 0; n < 2; ++n) {
          std::size_t best = kJointCount;
          for (std::size_t j = 0; j < kJointCount; ++j) {
            if (model->open()[j] && !two[j] && (best == kJointCount || size[j] > size[best]))
              best = j;
          }
          if (best < kJointCount) two.set(best);
        }
        return two;
      };
      JointVectors error;
      joint_errors(*trial.reference, given.reference_time, given.learner, error);
      std::array<double, kJointCount> angle{}, weighted{};
      for (std::size_t j = 0; j < kJointCount; ++j) {
        angle[j] = error[j].norm();
        weighted[j] = trial.reference->weight[j] * std::max(0.0, angle[j] - model->dead_band(j));
      }
      const CorrectionResult result = ours->solve(given, kNoHurry);
      JointSet asked;
      for (std::size_t j = 0; j < kJointCount; ++j) asked[j] = !result.target[j].isZero();
      comparison.asked += asked.count();
      count(kOurs, result);
      count(kLargestError, only(two_largest(weighted)));
      count(kLargestAngle, only(two_largest(angle)));
      const CorrectionResult all = only(JointSet().set());
      count(kAllJoints, all);
      count(kOfAll, only(two_largest(all.benefit)));
      if (!exhaustive) continue;
      // Every pair with its best amounts; the solver then solves for the ten of least cost.
      constexpr int kSteps = 12;
      constexpr std::size_t kSolved = 10;
      std::vector<std::pair<double, JointSet>> pairs;
      std::vector<double> delta(model->size());
      for (std::size_t a = 0; a < kJointCount; ++a) {
        for (std::size_t b = a + 1; b < kJointCount; ++b) {
          if (!model->open()[a] || !model->open()[b]) continue;
          const JointSet pair = JointSet().set(a).set(b);
          pairs.emplace_back(every->amounts(pair, kSteps, delta), pair);
        }
      }
      std::sort(pairs.begin(), pairs.end(),
                [](const auto& a, const auto& b) { return a.first < b.first; });
      if (pairs.size() > kSolved) pairs.resize(kSolved);
      CorrectionResult best;
      JointSet best_pair;
      double least = std::numeric_limits<double>::infinity();
      for (const auto& [cost, pair] : pairs) {
        const CorrectionResult of_pair = only(pair);
        const double left = model->cost(asked_delta(*model, given, of_pair));
        if (left < least) {
          least = left;
          best = of_pair;
          best_pair = pair;
        }
      }
      if (best_pair.none()) best = result;  // fewer than two joints are wrong
      comparison.same_pair += best_pair.none() || (asked & ~best_pair).none() ? 1 : 0;
      count(kBestPair, best);
    }
  }
  return comparison;
}

// A share and its 95 % interval: percentile bootstrap over the clusters.
struct Share {
  double value, low, high;
};
template <typename Measure>
Share bootstrap(const Comparison& comparison, Measure measure) {
  std::vector<const Cluster*> clusters;
  for (const auto& [name, cluster] : comparison.clusters) clusters.push_back(&cluster);
  std::mt19937 random(1);
  std::vector<double> values;
  for (int draw = 0; draw < 2000; ++draw) {
    std::vector<const Cluster*> drawn;
    for (std::size_t i = 0; i < clusters.size(); ++i) {
      drawn.push_back(
          clusters[std::uniform_int_distribution<std::size_t>(0, clusters.size() - 1)(random)]);
    }
    values.push_back(measure(drawn));
  }
  return {measure(clusters), quantile(values, 0.025), quantile(values, 0.975)};
}

double share_removed(const std::vector<const Cluster*>& clusters, Choice choice, bool task) {
  double before = 0.0, left = 0.0;
  for (const Cluster* cluster : clusters) {
    const Removed& r = cluster->removed[choice];
    before += task ? r.task : r.whole;
    left += task ? r.task_left : r.whole_left;
  }
  return before > 0.0 ? 100.0 * (before - left) / before : 0.0;
}

nlohmann::json choice_report(const Comparison& c, bool exhaustive) {
  nlohmann::json out{{"name", c.name},
                     {"problems", c.problems},
                     {"clusters", c.clusters.size()},
                     {"cluster_is", c.unit},
                     {"joints_asked", static_cast<double>(c.asked) /
                                          std::max(1.0, static_cast<double>(c.problems))},
                     {"asked_in_best_pair", static_cast<double>(c.same_pair) /
                                                std::max(1.0, static_cast<double>(c.problems))}};
  for (const bool task : {true, false}) {
    const char* measure = task ? "task_space" : "whole";
    for (int i = 0; i < kChoices; ++i) {
      const auto choice = static_cast<Choice>(i);
      if (choice == kBestPair && !exhaustive) continue;
      const auto of = [&](Choice which) {
        return [=](const std::vector<const Cluster*>& drawn) {
          return share_removed(drawn, which, task);
        };
      };
      const Share share = bootstrap(c, of(choice));
      const Share gain = bootstrap(c, [&](const std::vector<const Cluster*>& drawn) {
        return share_removed(drawn, kOurs, task) - share_removed(drawn, choice, task);
      });
      out[measure][kChoiceNames[choice]] = {{"removed", {share.value, share.low, share.high}},
                                            {"ours_more", {gain.value, gain.low, gain.high}}};
    }
  }
  return out;
}

void print_choices(const nlohmann::json& r) {
  fmt::print("\n{}: {} problems, {} {}, {:.2f} joints asked, in the best pair {:.0f} %\n",
             r["name"].get<std::string>(), r["problems"].get<int>(), r["clusters"].get<int>(),
             r["cluster_is"].get<std::string>(), r["joints_asked"].get<double>(),
             100.0 * r["asked_in_best_pair"].get<double>());
  fmt::print("{:<52} {:>22} {:>22}   {:>22} {:>22}\n", "removed [%], 95 % interval", "task space",
             "ours more", "all error", "ours more");
  for (const char* name : kChoiceNames) {
    if (!r["task_space"].contains(name)) continue;
    const auto text = [&](const char* measure, const char* what) {
      const auto& v = r[measure][name][what];
      return fmt::format("{:.1f} ({:.1f} to {:.1f})", v[0].get<double>(), v[1].get<double>(),
                         v[2].get<double>());
    };
    fmt::print("{:<52} {:>22} {:>22}   {:>22} {:>22}\n", name, text("task_space", "removed"),
               text("task_space", "ours_more"), text("whole", "removed"),
               text("whole", "ours_more"));
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Solve times of the correction over a moving sequence"};
  const std::filesystem::path root = SECONDSKIN_SOURCE_DIR;
  std::filesystem::path reference_path = root / "reference_motions" / "squat";
  std::filesystem::path joint_maps = root / "joint_maps";
  double seconds = 100.0, stray_deg = 6.0, mistake_deg = 25.0;
  unsigned seed = 1;
  bool standing = false, json = false, exhaustive = true, timing = true;
  std::filesystem::path data = root.parent_path() / "shared" / "data";
  int repetitions = 3, per_repetition = 4;
  SolveLimit limit;
  app.add_option("--reference", reference_path, "folder or motion file");
  app.add_option("--joint-maps", joint_maps);
  app.add_option("--seconds", seconds, "of the session");
  app.add_option("--stray", stray_deg, "amplitude of every joint's error [deg]");
  app.add_option("--mistake", mistake_deg, "amplitude of three joints' error [deg]");
  app.add_option("--seed", seed);
  app.add_flag("--standing", standing, "balance counts, whatever the reference says");
  app.add_option("--deadline", limit.deadline, "of a solve [s]");
  app.add_option("--data", data, "real recordings, for the choice of joints");
  app.add_option("--repetitions", repetitions, "of each person's incorrect executions");
  app.add_option("--per-repetition", per_repetition, "problems of each repetition");
  app.add_flag("--pairs,!--no-pairs", exhaustive, "search all pairs of joints too");
  app.add_flag("--timing,!--no-timing", timing, "solve times");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);

  nlohmann::json choices = nlohmann::json::array();
  const auto compare_all = [&](const TrialSet& set) {
    if (set.trials.empty()) return;  // its files are not there
    choices.push_back(choice_report(compare(set, exhaustive), exhaustive));
    if (!json) print_choices(choices.back());
    std::fflush(stdout);
  };
  if (std::filesystem::exists(data)) {
    const std::filesystem::path cmu = data / "bvh" / "cmu";
    if (std::filesystem::exists(cmu)) {
      compare_all(karate_trials(cmu, root / "reference_motions", joint_maps, per_repetition));
    }
    for (const TrialSet& set : rehab_trials(data / "rehab" / "ui-prmd", root / "marker_sets",
                                            repetitions, per_repetition)) {
      compare_all(set);
    }
  } else if (!json) {
    fmt::print("{} is not there: nothing to choose joints for\n", data.string());
  }
  if (!timing) {
    if (json) fmt::print("{}\n", nlohmann::json{{"choices", choices}}.dump(2));
    return 0;
  }

  Reference loaded = load_reference(reference_path, joint_maps);
  loaded.standing = loaded.standing || standing;
  const auto reference = std::make_shared<const Reference>(std::move(loaded));
  const Skeleton body = canonical_skeleton(1.65);
  Learner learner(*reference, stray_deg * kDegree, mistake_deg * kDegree, seed);

  std::vector<Series> all;
  const auto run = [&](const std::string& name, double rate_hz, bool cold) {
    Series series;
    series.name = name;
    auto solver = std::make_unique<CorrectionSolver>(reference, body);
    const auto count = static_cast<int>(cold ? 100 : seconds * rate_hz);
    for (int i = 0; i < count; ++i) {
      if (cold) solver = std::make_unique<CorrectionSolver>(reference, body);
      const CorrectionProblem problem = learner.at(cold ? seconds * i / count : i / rate_hz);
      const double before = thread_cpu_time();
      const CorrectionResult result = solver->solve(problem, limit);
      series.add(result, thread_cpu_time() - before);
    }
    all.push_back(std::move(series));
  };
  run("15 problems a second, warm", 15.0, false);
  run("62.5 problems a second, warm", 62.5, false);
  run("cold", 0.0, true);

  CorrectionModel model(reference, body, {});
  const CorrectionProblem problem = learner.at(1.0);
  (void)model.pose(problem);
  const std::size_t n = model.size();
  std::vector<double> delta(n, 0.0), gradient(n), hessian(n * n);
  const std::vector<double> multipliers(model.constraints(), 1.0);
  JointSelection selection(model);
  const auto fresh = [&](int i) { delta[0] = 1e-7 * i; };  // or the model answers from memory
  const std::vector<std::pair<std::string, double>> parts{
      {"pose (prediction, bounds)", mean_time([&](int) { (void)model.pose(problem); })},
      {"objective", mean_time([&](int i) { fresh(i), (void)model.cost(delta); })},
      {"objective + gradient",
       mean_time([&](int i) { fresh(i), model.gradient(delta, gradient); })},
      {"objective + Gauss-Newton",
       mean_time([&](int i) { fresh(i), model.hessian(delta, hessian); })},
      {"objective + exact Hessian, all joints",
       mean_time([&](int i) { fresh(i), model.exact_hessian(delta, 1.0, multipliers, hessian); })},
      {"choice of two joints", mean_time([&](int) {
         (void)model.pose(problem);
         (void)selection.select(2, {}, delta);
       })}};

  if (json) {
    nlohmann::json out{{"reference", reference->name},
                       {"degrees_of_freedom", n},
                       {"knots", kKnots},
                       {"balance_constraints", model.constraints()},
                       {"choices", choices}};
    for (const Series& series : all) out["series"].push_back(report(series));
    for (const auto& [name, time] : parts) out["model_us"][name] = 1e6 * time;
    fmt::print("{}\n", out.dump(2));
    return 0;
  }
  fmt::print("{}: {} degrees of freedom, {} knots, {} balance constraints\n\n", reference->name, n,
             kKnots, model.constraints());
  fmt::print(
      "{:<30} {:>6} | {:>6} {:>6} {:>6} {:>6} | {:>6} {:>6} | {:>4} {:>4} | {:>5} {:>5} {:>5} | "
      "{:>5}\n",
      "", "solves", "p50", "p90", "p99", "max", "p50", "p99", "p50", "p99", "conv", "dead", "fall",
      "asked");
  fmt::print("{:<30} {:>6} | {:>27} | {:>13} | {:>9} | {:>17} | {:>5}\n", "", "", "wall [ms]",
             "CPU [ms]", "iter", "share [%]", "joint");
  for (const Series& series : all) {
    const auto r = report(series);
    const auto percent = [&](const char* key) { return 100.0 * r[key].get<double>(); };
    fmt::print(
        "{:<30} {:>6} | {:>6.2f} {:>6.2f} {:>6.2f} {:>6.2f} | {:>6.2f} {:>6.2f} | {:>4.0f} "
        "{:>4.0f} | "
        "{:>5.1f} {:>5.1f} {:>5.1f} | {:>5.1f}\n",
        series.name, series.wall.size(), r["wall_ms"]["p50"].get<double>(),
        r["wall_ms"]["p90"].get<double>(), r["wall_ms"]["p99"].get<double>(),
        r["wall_ms"]["max"].get<double>(), r["cpu_ms"]["p50"].get<double>(),
        r["cpu_ms"]["p99"].get<double>(), r["iterations"]["p50"].get<double>(),
        r["iterations"]["p99"].get<double>(), percent("converged"), percent("deadline"),
        percent("fallback"), r["joints_asked"].get<double>());
  }
  fmt::print("\nSolve times, number per millisecond (the last: 15 and more)\n");
  for (const Series& series : all) {
    fmt::print("{:<30}", series.name);
    const nlohmann::json r = report(series);
    for (const auto& bin : r["histogram_ms"]) fmt::print(" {:>4}", bin.get<int>());
    fmt::print("\n");
  }
  fmt::print("\nThe programme's own part, CPU\n");
  for (const auto& [name, time] : parts) fmt::print("{:<38} {:>6.1f} us\n", name, 1e6 * time);
  return 0;
}
