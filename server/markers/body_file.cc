#include "server/markers/body_file.h"

#include <set>

#include "motion/toml_fields.h"
#include "motion/whole_file.h"

namespace secondskin::server {
namespace {

constexpr double kFarthest = 3.0;  // from a joint, on any body [m]

std::string written(const Eigen::Vector3d& v) {
  return fmt::format("[{:.6f}, {:.6f}, {:.6f}]", v.x(), v.y(), v.z());
}

}  // namespace

void save_body(const MarkerBody& body, const std::filesystem::path& file) {
  std::string out =
      "# A wearer's body: where each joint lies in its parent's frame, and each marker on its\n"
      "# segment [m]. Made by 'secondskin calibrate skeleton'.\n";
  for (const Segment& segment : body.skeleton.segments()) {
    out += fmt::format(
        "\n[[segment]]\nname = \"{}\"\np_PB = {}\np_BE = {}\nmass_fraction = {:.6f}\np_BC = {}\n",
        segment.name, written(segment.p_PB), written(segment.p_BE), segment.mass_fraction,
        written(segment.p_BC));
  }
  for (const Attachment& a : body.attachments) {
    out += fmt::format(
        "\n[[marker]]\nindex = {}\nname = \"{}\"\nsegment = \"{}\"\np_BM = {}\nsigma = {:.6f}\n",
        a.marker, a.name, joint_name(a.segment), written(a.p_BM), a.sigma);
  }
  write_whole_file(file, out);
}

MarkerBody load_body(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields top(file, table);
  top.allow({"segment", "marker"});
  std::vector<Segment> segments;
  top.each("segment", [&](const TomlFields& in) {
    in.allow({"name", "p_PB", "p_BE", "mass_fraction", "p_BC"});
    const std::size_t i = segments.size();
    if (i >= kJointCount)
      in.fail("name", fmt::format("{} segments, this is one more", kJointCount));
    const JointAnatomy& anatomy = canonical_anatomy()[i];
    if (in.text("name") != anatomy.name) in.fail("name", fmt::format("\"{}\"", anatomy.name));
    Segment segment;
    segment.name = anatomy.name;
    if (i > 0) segment.parent = index(anatomy.parent);
    segment.p_PB = in.vector("p_PB", kFarthest);
    segment.p_BE = in.vector("p_BE", kFarthest);
    segment.mass_fraction = in.number("mass_fraction", 0.0, 1.0);
    segment.p_BC = in.vector("p_BC", kFarthest);
    segments.push_back(std::move(segment));
  });
  if (segments.size() != kJointCount) {
    top.fail("segment", fmt::format("{} segments, found {}", kJointCount, segments.size()));
  }
  MarkerBody body{Skeleton(std::move(segments)), {}};
  std::set<std::string> names;
  std::set<std::size_t> indices;
  top.each("marker", [&](const TomlFields& in) {
    in.allow({"index", "name", "segment", "p_BM", "sigma"});
    Attachment a;
    a.marker = in.whole("index", 0, 1 << 16);
    a.name = in.text("name");
    a.segment = in.joint("segment");
    a.p_BM = in.vector("p_BM", kFarthest);
    a.sigma = in.number("sigma", 1e-4, 0.5);
    if (!names.insert(a.name).second) in.fail("name", "each name once");
    if (!indices.insert(a.marker).second) in.fail("index", "each index once");
    body.attachments.push_back(std::move(a));
  });
  return body;
}

}  // namespace secondskin::server
