// What forward kinematics and the Jacobians that the coach's solver needs cost a pose: hands, feet
// and head, over the poses of a recorded learner.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <array>
#include <functional>
#include <nlohmann/json.hpp>

#include "bench/live_session.h"
#include "motion/anatomy.h"
#include "motion/kinematics.h"

namespace {

using namespace secondskin;

constexpr std::array kPoints = {Joint::kLeftWrist, Joint::kRightWrist, Joint::kLeftAnkle,
                                Joint::kRightAnkle, Joint::kHead};

double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Processor time of forward kinematics and Jacobians, nanoseconds a pose"};
  std::string name = "low_block";
  int repeats = 31, passes = 20;
  bool json = false;
  app.add_option("--reference", name, "whose learner's poses")->capture_default_str();
  app.add_option("--repeats", repeats, "the median of so many is printed")->capture_default_str();
  app.add_option("--passes", passes, "over all poses, each repeat")->capture_default_str();
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);

  const Motion motion = bench::learner_of(name);
  const Skeleton& skeleton = motion.skeleton;
  std::vector<Eigen::Isometry3d> X_WB(skeleton.size());
  Eigen::Matrix3Xd J(3, 3 + 3 * skeleton.size());
  double sink = 0.0;  // printed, so that nothing can be left out

  const auto place = [&](const Pose& pose) {
    forward_kinematics(skeleton, pose.p_WR, pose.q_PB, X_WB);
    sink += X_WB.back().translation().z();
  };
  const auto points = [&] {
    for (const Joint joint : kPoints) {
      const std::size_t i = index(joint);
      position_jacobian(skeleton, X_WB, i, skeleton[i].p_BE, J);
      sink += J(2, 3);
    }
  };
  struct Part {
    std::string name;
    std::function<void(const Pose&)> work;
    std::vector<double> ns = {};
  };
  std::vector<Part> parts{
      {"forward kinematics", place},
      {"5 position Jacobians", [&](const Pose&) { points(); }},
      {"forward kinematics + 5 position Jacobians",
       [&](const Pose& pose) {
         place(pose);
         points();
       }},
      {"5 orientation Jacobians",
       [&](const Pose&) {
         for (const Joint joint : kPoints) orientation_jacobian(skeleton, X_WB, index(joint), J);
         sink += J(2, 3);
       }},
      {"centre of mass", [&](const Pose&) { sink += centre_of_mass(skeleton, X_WB).z(); }},
  };
  for (int repeat = 0; repeat <= repeats; ++repeat) {
    for (Part& part : parts) {
      const double start = cpu_time();
      for (int pass = 0; pass < passes; ++pass) {
        for (const Pose& pose : motion.poses) part.work(pose);
      }
      const double poses = static_cast<double>(motion.poses.size()) * passes;
      if (repeat > 0) part.ns.push_back(1e9 * (cpu_time() - start) / poses);  // the first warms up
    }
  }

  if (json) {
    nlohmann::json out{{"reference", name},
                       {"segments", skeleton.size()},
                       {"poses", motion.poses.size()},
                       {"checksum", sink}};
    for (const Part& part : parts) {
      out["ns_per_pose"][part.name] = {{"median", bench::quantile(part.ns, 0.5)},
                                       {"min", bench::quantile(part.ns, 0.0)},
                                       {"max", bench::quantile(part.ns, 1.0)}};
    }
    fmt::print("{}\n", out.dump(2));
    return 0;
  }
  fmt::print("{} segments, {} poses of {}'s learner; {} repeats (checksum {:.3g})\n\n",
             skeleton.size(), motion.poses.size(), name, repeats, sink);
  fmt::print("{:<44} {:>7} {:>7} {:>7}   CPU, ns a pose\n", "", "median", "min", "max");
  for (const Part& part : parts) {
    fmt::print("{:<44} {:>7.0f} {:>7.0f} {:>7.0f}\n", part.name, bench::quantile(part.ns, 0.5),
               bench::quantile(part.ns, 0.0), bench::quantile(part.ns, 1.0));
  }
  return 0;
}
