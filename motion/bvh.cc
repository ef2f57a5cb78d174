#include "motion/bvh.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <fstream>
#include <istream>
#include <iterator>
#include <numbers>
#include <ostream>
#include <sstream>
#include <system_error>
#include <unordered_set>
#include <utility>

namespace secondskin {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// Larger numbers are no lengths or angles in any unit, and would overflow further on.
constexpr double kLargestValue = 1e9;

bool is_blank(char c) noexcept {
  return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
}
char lower(char c) noexcept { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }

bool equals_ignoring_case(std::string_view a, std::string_view b) noexcept {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](char x, char y) { return lower(x) == lower(y); });
}

// Channels 0-2 are positions x y z, 3-5 rotations about x y z.
using Channel = std::uint8_t;
constexpr std::array<std::string_view, 6> kChannelNames{"Xposition", "Yposition", "Zposition",
                                                        "Xrotation", "Yrotation", "Zrotation"};
bool is_position(Channel c) noexcept { return c < 3; }

struct JointChannels {
  std::array<Channel, 6> channel{};
  std::size_t count = 0;
};

// The text and the place reached in it. Line and column are counted only when an error needs them.
class Cursor {
 public:
  Cursor(std::string_view text, std::string_view name) : text_(text), name_(name) {
    if (text_.starts_with("\xEF\xBB\xBF")) at_ = 3;
  }

  [[noreturn]] void fail(std::size_t where, std::string_view found,
                         std::string_view expected) const {
    where = std::min(where, text_.size());
    const std::string_view before = text_.substr(0, where);
    const auto line = 1 + std::count(before.begin(), before.end(), '\n');
    const std::size_t start = before.rfind('\n');
    const std::size_t column = start == std::string_view::npos ? where + 1 : where - start;
    throw BvhError(
        fmt::format("{}:{}:{}: found {}, expected {}", name_, line, column, found, expected));
  }
  [[noreturn]] void fail_token(std::string_view token, std::string_view expected) const {
    if (token.data() == nullptr || token.empty()) {
      fail(at_, at_ >= text_.size() ? "the end of the file" : "the end of the line", expected);
    }
    fail(offset(token), quoted(token), expected);
  }

  bool at_end() const noexcept { return at_ >= text_.size(); }
  std::size_t position() const noexcept { return at_; }
  std::size_t remaining() const noexcept { return text_.size() - at_; }
  std::size_t offset(std::string_view token) const noexcept {
    return static_cast<std::size_t>(token.data() - text_.data());
  }

  /// The next word, over line ends; empty at the end of the file.
  std::string_view word() noexcept {
    while (at_ < text_.size() && (is_blank(text_[at_]) || text_[at_] == '\n')) ++at_;
    return take_word();
  }
  /// The next word of this line; empty at its end, which is not passed.
  std::string_view word_in_line() noexcept {
    while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
    return take_word();
  }
  /// What is left of this line without blanks around it; its end is passed.
  std::string_view rest_of_line() noexcept {
    const std::size_t end = std::min(text_.find('\n', at_), text_.size());
    std::string_view rest = text_.substr(at_, end - at_);
    at_ = std::min(end + 1, text_.size());
    while (!rest.empty() && is_blank(rest.front())) rest.remove_prefix(1);
    while (!rest.empty() && is_blank(rest.back())) rest.remove_suffix(1);
    return rest;
  }
  void step_back(std::string_view token) noexcept { at_ = offset(token); }
  /// Passes the line's end; false when something else is there.
  bool end_line() noexcept {
    while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
    if (at_ < text_.size() && text_[at_] != '\n') return false;
    if (at_ < text_.size()) ++at_;
    return true;
  }
  bool skip(char c) noexcept {
    while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }

  double number(std::string_view token, std::string_view expected) const {
    const char* begin = token.data();
    const char* end = begin + token.size();
    if (begin != end && *begin == '+') ++begin;
    double value = 0.0;
    const auto [stop, error] = std::from_chars(begin, end, value);
    // The comparison also refuses NaN.
    if (begin == end || stop != end || error != std::errc() ||
        !(std::abs(value) <= kLargestValue)) {
      fail_token(token, expected);
    }
    return value;
  }

  static std::string quoted(std::string_view token) {
    constexpr std::size_t kLongest = 40;
    std::string shown(token.substr(0, kLongest));
    std::replace_if(
        shown.begin(), shown.end(), [](char c) { return static_cast<unsigned char>(c) < 32; }, '?');
    return fmt::format("\"{}{}\"", shown, token.size() > kLongest ? "..." : "");
  }

 private:
  std::string_view take_word() noexcept {
    const std::size_t begin = at_;
    while (at_ < text_.size() && !is_blank(text_[at_]) && text_[at_] != '\n') ++at_;
    return text_.substr(begin, at_ - begin);
  }

  std::string_view text_;
  std::string_view name_;
  std::size_t at_ = 0;
};

class Parser {
 public:
  Parser(std::string_view text, std::string_view name) : in_(text, name) {}

  BvhFile parse() {
    read_hierarchy();
    return read_motion();
  }

 private:
  void expect(std::string_view keyword) {
    const std::string_view token = in_.word();
    if (!equals_ignoring_case(token, keyword)) in_.fail_token(token, keyword);
  }

  Eigen::Vector3d read_offset() {
    Eigen::Vector3d offset;
    for (double& value : offset)
      value = in_.number(in_.word_in_line(), "three finite numbers after OFFSET");
    if (!in_.end_line()) in_.fail_token(in_.word(), "the end of the line after three numbers");
    return offset;
  }

  JointChannels read_channels() {
    constexpr std::string_view kCount = "a number of channels from 1 to 6";
    const std::string_view count = in_.word_in_line();
    JointChannels result;
    const auto [stop, error] =
        std::from_chars(count.data(), count.data() + count.size(), result.count);
    if (error != std::errc() || stop != count.data() + count.size() || result.count < 1 ||
        result.count > 6) {
      in_.fail_token(count, kCount);
    }
    for (std::size_t i = 0; i < result.count; ++i) {
      const std::string_view token = in_.word_in_line();
      const auto known =
          std::find_if(kChannelNames.begin(), kChannelNames.end(),
                       [&](std::string_view name) { return equals_ignoring_case(name, token); });
      if (known == kChannelNames.end()) {
        in_.fail_token(token, "Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation");
      }
      const auto channel = static_cast<Channel>(known - kChannelNames.begin());
      const auto end = result.channel.begin() + static_cast<std::ptrdiff_t>(i);
      if (std::find(result.channel.begin(), end, channel) != end) {
        in_.fail_token(token, "each channel once");
      }
      result.channel[i] = channel;
    }
    if (!in_.end_line()) {
      in_.fail_token(in_.word(),
                     fmt::format("the end of the line after {} channels", result.count));
    }
    return result;
  }

  // A name is the rest of the line, for names may hold blanks; the brace may follow on the line.
  std::string_view read_name() {
    std::string_view name = in_.rest_of_line();
    if (name.ends_with('{')) {
      in_.step_back(name.substr(name.size() - 1));
      name.remove_suffix(1);
      while (!name.empty() && is_blank(name.back())) name.remove_suffix(1);
    }
    return name;
  }

  void open_joint(std::optional<std::size_t> parent) {
    const std::size_t before = in_.position();
    const std::string_view name = read_name();
    if (name.empty()) in_.fail(before, "no name", "a joint's name");
    if (!names_.insert(name).second) in_.fail_token(name, "a name that no other joint has");
    expect("{");
    segments_.push_back(Segment{.name = std::string(name), .parent = parent});
    channels_.emplace_back();
    has_offset_.push_back(false);
    has_end_.push_back(false);
  }

  void read_end_site(std::size_t joint) {
    read_name();
    expect("{");
    expect("OFFSET");
    segments_[joint].p_BE = read_offset();
    has_end_[joint] = true;
    expect("}");
  }

  void require_complete(std::size_t joint, std::string_view token) {
    if (!has_offset_[joint]) in_.fail_token(token, "OFFSET");
    if (channels_[joint].count == 0) in_.fail_token(token, "CHANNELS");
  }

  void read_hierarchy() {
    expect("HIERARCHY");
    expect("ROOT");
    open_joint(std::nullopt);
    std::size_t joint = 0;
    for (bool open = true; open;) {
      const std::string_view token = in_.word();
      if (equals_ignoring_case(token, "OFFSET")) {
        if (has_offset_[joint]) in_.fail_token(token, "one OFFSET a joint");
        segments_[joint].p_PB = read_offset();
        has_offset_[joint] = true;
      } else if (equals_ignoring_case(token, "CHANNELS")) {
        if (channels_[joint].count > 0) in_.fail_token(token, "one CHANNELS a joint");
        channels_[joint] = read_channels();
      } else if (equals_ignoring_case(token, "JOINT")) {
        require_complete(joint, token);
        open_joint(joint);
        joint = segments_.size() - 1;
      } else if (equals_ignoring_case(token, "End")) {
        require_complete(joint, token);
        read_end_site(joint);
      } else if (token == "}") {
        require_complete(joint, token);
        if (segments_[joint].parent) {
          joint = *segments_[joint].parent;
        } else {
          open = false;
        }
      } else {
        in_.fail_token(token, "OFFSET, CHANNELS, JOINT, End Site or }");
      }
    }
    // A segment without an end of its own ends at its first child.
    for (std::size_t i = segments_.size(); i-- > 1;) {
      const std::size_t parent = *segments_[i].parent;
      if (!has_end_[parent]) segments_[parent].p_BE = segments_[i].p_PB;
    }
    for (const JointChannels& c : channels_) values_a_frame_ += c.count;
  }

  std::size_t read_frame_count() {
    constexpr std::string_view kExpected = "a number of frames of at least 1";
    const std::string_view token = in_.word_in_line();
    std::size_t count = 0;
    const auto [stop, error] = std::from_chars(token.data(), token.data() + token.size(), count);
    if (error != std::errc() || stop != token.data() + token.size() || count < 1) {
      in_.fail_token(token, kExpected);
    }
    return count;
  }

  // The file's frame time is rounded: 0.008333 means 120 Hz. The whole rate whose period rounds to
  // the printed digits is taken, if it is as near as that.
  double read_rate() {
    constexpr std::string_view kExpected = "seconds from 0.000001 to 3600";
    const std::string_view token = in_.word_in_line();
    const double period = in_.number(token, kExpected);
    if (!(period >= 1e-6 && period <= 3600.0)) in_.fail_token(token, kExpected);
    const double rate = 1.0 / period;
    const double whole = std::round(rate);
    const std::size_t point = token.find('.');
    if (whole >= 1.0 && point != std::string_view::npos &&
        token.find_first_of("eE") == std::string_view::npos) {
      const double half_digit =
          0.5 * std::pow(10.0, -static_cast<double>(token.size() - point - 1));
      if (std::abs(1.0 / whole - period) <= 1.001 * half_digit &&
          std::abs(whole / rate - 1.0) < 1e-4) {
        return whole;
      }
    }
    return rate;
  }

  Pose read_pose(std::size_t frame, std::size_t frames) {
    for (std::size_t i = 0; i < values_.size(); ++i) {
      const std::string_view token = in_.word_in_line();
      if (token.empty()) {
        in_.fail(in_.position(),
                 fmt::format("{} after {} values of frame {} of {}",
                             in_.at_end() ? "the end of the file" : "the end of the line", i,
                             frame + 1, frames),
                 fmt::format("{} values", values_.size()));
      }
      values_[i] = in_.number(token, "a finite number");
    }
    if (!in_.end_line()) {
      in_.fail_token(in_.word(),
                     fmt::format("the end of the line after {} values", values_.size()));
    }
    Pose pose(segments_.size());
    pose.p_WR = segments_[0].p_PB;
    std::size_t at = 0;
    for (std::size_t joint = 0; joint < segments_.size(); ++joint) {
      Eigen::Quaterniond& q = pose.q_PB[joint];
      const JointChannels& channels = channels_[joint];
      for (std::size_t k = 0; k < channels.count; ++k) {
        const Channel channel = channels.channel[k];
        const double value = values_[at++];
        if (is_position(channel)) {
          if (joint == 0) pose.p_WR[channel] = value;
          continue;
        }
        if (value == 0.0) continue;
        // Intrinsic rotations in the order of the channels: q * [cos, sin * axis].
        const double half = 0.5 * kDegree * value;
        const double c = std::cos(half), s = std::sin(half);
        const double w = q.w(), x = q.x(), y = q.y(), z = q.z();
        if (channel == 3) {
          q = {c * w - s * x, c * x + s * w, c * y + s * z, c * z - s * y};
        } else if (channel == 4) {
          q = {c * w - s * y, c * x - s * z, c * y + s * w, c * z + s * x};
        } else {
          q = {c * w - s * z, c * x + s * y, c * y - s * x, c * z + s * w};
        }
      }
    }
    return pose;
  }

  BvhFile read_motion() {
    expect("MOTION");
    // "Frames:" or "Frame Time:"; the colon may stand apart.
    const auto expect_label = [&](std::string_view label) {
      std::string_view rest = label;
      std::string_view token = in_.word();
      for (;;) {
        const std::string_view keyword = rest.substr(0, rest.find(' '));
        const bool last = keyword.size() == rest.size();
        const bool colon = last && token.ends_with(':');
        if (!equals_ignoring_case(token.substr(0, token.size() - (colon ? 1 : 0)), keyword)) {
          in_.fail_token(token, fmt::format("{}:", label));
        }
        if (last && !colon && !in_.skip(':')) {
          in_.fail_token(in_.word_in_line(), fmt::format("{}:", label));
        }
        if (last) return;
        rest.remove_prefix(keyword.size() + 1);
        token = in_.word_in_line();
      }
    };
    expect_label("Frames");
    const std::size_t frames = read_frame_count();
    expect_label("Frame Time");
    const double rate = read_rate();
    if (!in_.end_line()) in_.fail_token(in_.word(), "the end of the line after the frame time");

    values_.resize(values_a_frame_);
    std::vector<Pose> poses;
    // A value takes at least two bytes: never reserve for more frames than the text can hold.
    poses.reserve(std::min(frames, in_.remaining() / (2 * values_a_frame_) + 1));
    for (;;) {
      const std::string_view next = in_.word();
      if (next.empty()) break;
      if (poses.size() == frames) {
        in_.fail_token(next, fmt::format("the end of the file after {} frames", frames));
      }
      in_.step_back(next);
      poses.push_back(read_pose(poses.size(), frames));
    }
    if (poses.size() < frames) {
      in_.fail(in_.position(), fmt::format("the end of the file after {} frames", poses.size()),
               fmt::format("{} frames", frames));
    }
    std::size_t ignored = 0;
    for (std::size_t joint = 1; joint < channels_.size(); ++joint) {
      const JointChannels& c = channels_[joint];
      const auto end = c.channel.begin() + static_cast<std::ptrdiff_t>(c.count);
      if (std::any_of(c.channel.begin(), end, is_position)) ++ignored;
    }
    return {Motion{Skeleton(std::move(segments_)), rate, std::move(poses)}, ignored};
  }

  Cursor in_;
  std::vector<Segment> segments_;
  std::vector<JointChannels> channels_;
  std::vector<bool> has_offset_;
  std::vector<bool> has_end_;
  std::unordered_set<std::string_view> names_;
  std::size_t values_a_frame_ = 0;
  std::vector<double> values_;
};

// R = Rz(z) Rx(x) Ry(y) in degrees. At gimbal lock the first angle may be anything; the others are
// read from what it leaves, so that the product is right everywhere.
struct ZxyAngles {
  double z, x, y;
};
ZxyAngles zxy_degrees(const Eigen::Quaterniond& q) {
  const Eigen::Matrix3d R = q.normalized().toRotationMatrix();
  const double z = std::atan2(-R(0, 1), R(1, 1));
  const double c = std::cos(z), s = std::sin(z);
  // Rows of Rz(-z) R = Rx(x) Ry(y), whose first row is [cos y, 0, sin y] and second column
  // [0, cos x, sin x].
  const double cos_y = c * R(0, 0) + s * R(1, 0);
  const double sin_y = c * R(0, 2) + s * R(1, 2);
  const double cos_x = c * R(1, 1) - s * R(0, 1);
  return {z / kDegree, std::atan2(R(2, 1), cos_x) / kDegree, std::atan2(sin_y, cos_y) / kDegree};
}

// Segments in the order in which a hierarchy is written: each one's whole subtree after it.
struct Writer {
  explicit Writer(const Skeleton& s) : skeleton(s), children(s.size()) {
    for (std::size_t i = 1; i < s.size(); ++i) children[*s[i].parent].push_back(i);
  }

  void hierarchy(fmt::memory_buffer& text) {
    auto at = std::back_inserter(text);
    fmt::format_to(at, "HIERARCHY\n");
    struct Open {
      std::size_t segment;
      std::size_t next_child;
    };
    std::vector<Open> open;
    const auto begin = [&](std::size_t i) {
      const std::string indent(open.size(), '\t');
      const Eigen::Vector3d p = i == 0 ? Eigen::Vector3d::Zero().eval() : skeleton[i].p_PB;
      fmt::format_to(at, "{0}{1} {2}\n{0}{{\n{0}\tOFFSET {3:.6f} {4:.6f} {5:.6f}\n", indent,
                     i == 0 ? "ROOT" : "JOINT", skeleton[i].name, p.x(), p.y(), p.z());
      fmt::format_to(at, "{}\tCHANNELS {}Zrotation Xrotation Yrotation\n", indent,
                     i == 0 ? "6 Xposition Yposition Zposition " : "3 ");
      if (children[i].empty()) {
        const Eigen::Vector3d& e = skeleton[i].p_BE;
        fmt::format_to(at,
                       "{0}\tEnd Site\n{0}\t{{\n{0}\t\tOFFSET {1:.6f} {2:.6f} {3:.6f}\n{0}\t}}\n",
                       indent, e.x(), e.y(), e.z());
      }
      order.push_back(i);
      open.push_back({i, 0});
    };
    begin(0);
    while (!open.empty()) {
      Open& top = open.back();
      if (top.next_child < children[top.segment].size()) {
        begin(children[top.segment][top.next_child++]);
      } else {
        open.pop_back();
        fmt::format_to(at, "{}}}\n", std::string(open.size(), '\t'));
      }
    }
  }

  void frame(fmt::memory_buffer& text, const Pose& pose) const {
    auto at = std::back_inserter(text);
    fmt::format_to(at, "{:.6f} {:.6f} {:.6f}", pose.p_WR.x(), pose.p_WR.y(), pose.p_WR.z());
    for (const std::size_t i : order) {
      const ZxyAngles a = zxy_degrees(pose.q_PB[i]);
      fmt::format_to(at, " {:.6f} {:.6f} {:.6f}", a.z, a.x, a.y);
    }
    text.push_back('\n');
  }

  const Skeleton& skeleton;
  std::vector<std::vector<std::size_t>> children;
  std::vector<std::size_t> order;
};

[[noreturn]] void throw_system_error(int error, const std::filesystem::path& file) {
  throw std::system_error(error != 0 ? error : EIO, std::generic_category(),
                          fmt::format("cannot write {}", file.string()));
}

}  // namespace

BvhFile read_bvh(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::error_code ignored;
  if (!in || std::filesystem::is_directory(file, ignored)) {
    throw BvhError(
        fmt::format("{}:1:1: found no readable file, expected a BVH file", file.string()));
  }
  return read_bvh(in, file.string());
}

BvhFile read_bvh(std::istream& in, std::string_view name) {
  std::string text;
  std::array<char, 1 << 16> block;
  while (in.read(block.data(), block.size()) || in.gcount() > 0) {
    text.append(block.data(), static_cast<std::size_t>(in.gcount()));
  }
  return Parser(text, name).parse();
}

void write_bvh(const Motion& motion, std::ostream& out) {
  Writer writer(motion.skeleton);
  fmt::memory_buffer text;
  writer.hierarchy(text);
  fmt::format_to(std::back_inserter(text), "MOTION\nFrames: {}\nFrame Time: {:.12f}\n",
                 motion.poses.size(), 1.0 / motion.rate_hz);
  for (const Pose& pose : motion.poses) {
    writer.frame(text, pose);
    if (text.size() > (1U << 16)) {
      out.write(text.data(), static_cast<std::streamsize>(text.size()));
      text.clear();
    }
  }
  out.write(text.data(), static_cast<std::streamsize>(text.size()));
}

void write_bvh(const Motion& motion, const std::filesystem::path& file) {
  std::filesystem::path partial = file;
  partial += ".partial";
  errno = 0;
  {
    std::ofstream out(partial, std::ios::binary | std::ios::trunc);
    if (!out) throw_system_error(errno, file);
    write_bvh(motion, out);
    out.close();
    if (!out) {
      const int error = errno;
      std::error_code ignored;
      std::filesystem::remove(partial, ignored);
      throw_system_error(error, file);
    }
  }
  std::error_code error;
  std::filesystem::rename(partial, file, error);
  if (error) {
    std::error_code ignored;
    std::filesystem::remove(partial, ignored);
    throw_system_error(error.value(), file);
  }
}

}  // namespace secondskin
