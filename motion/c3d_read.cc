#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <fstream>
#include <istream>
#include <optional>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "motion/c3d.h"
#include "motion/c3d_format.h"
#include "motion/vax_float.h"

namespace secondskin {
namespace {

using c3d::kBlock;

constexpr std::size_t kMaxDimensions = 7;

// How the points and samples lie in the data section. Header and parameters both tell it.
struct Layout {
  std::size_t points = 0;
  std::size_t channels = 0;
  std::size_t samples = 0;  // of each channel a frame
  std::size_t frames = 0;
  double scale = 0.0;  // negative: real storage

  bool real() const noexcept { return scale < 0.0; }
  std::size_t frame_bytes() const noexcept {
    return (4 * points + channels * samples) * (real() ? 4 : 2);
  }
  bool same_frame(const Layout& other) const noexcept {
    return points == other.points && channels * samples == other.channels * other.samples &&
           real() == other.real();
  }
  std::string text() const {
    return fmt::format("{} frames of {} points and {} analog samples, {}", frames, points,
                       channels * samples, real() ? "real" : "integer");
  }
};

class Reader {
 public:
  Reader(std::string_view bytes, std::string_view name) : bytes_(bytes), name_(name) {}

  C3dFile read() {
    read_parameter_section(read_key());
    choose_layout();
    read_rate_and_unit();
    name_points();
    name_channels();
    read_data();
    read_events();
    return std::move(file_);
  }

 private:
  [[noreturn]] void fail(std::size_t at, std::string_view found, std::string_view expected) const {
    throw C3dError(fmt::format("{}: byte {}: found {}, expected {}", name_, at, found, expected));
  }
  [[noreturn]] void fail(std::string_view parameter, std::string_view found,
                         std::string_view expected) const {
    throw C3dError(fmt::format("{}: {}: found {}, expected {}", name_, parameter, found, expected));
  }

  // Numbers at a place inside the file, which the caller has made sure of.
  std::uint8_t u8(std::size_t at) const noexcept { return static_cast<std::uint8_t>(bytes_[at]); }
  std::uint16_t u16(std::size_t at) const noexcept {
    const unsigned first = u8(at), second = u8(at + 1);
    return static_cast<std::uint16_t>(file_.processor == C3dProcessor::kSgi ? first << 8 | second
                                                                            : second << 8 | first);
  }
  std::int16_t i16(std::size_t at) const noexcept { return static_cast<std::int16_t>(u16(at)); }
  float f32(std::size_t at) const noexcept {
    const std::uint32_t first = u16(at), second = u16(at + 2);
    switch (file_.processor) {
      case C3dProcessor::kDec:
        return float_from_vax(first << 16 | second);
      case C3dProcessor::kSgi:
        return std::bit_cast<float>(first << 16 | second);
      case C3dProcessor::kIntel:
        break;
    }
    return std::bit_cast<float>(second << 16 | first);
  }

  // Words of the header count from 1.
  static constexpr std::size_t word(std::size_t n) noexcept { return 2 * (n - 1); }

  /// Returns where the parameter section begins.
  std::size_t read_key() {
    if (bytes_.size() < kBlock) {
      fail(bytes_.size(), "the end of the file", "a header of 512 bytes");
    }
    if (u8(1) != c3d::kKey) {
      fail(1, fmt::format("0x{:02X}", u8(1)), "0x50, which marks a C3D file");
    }
    const std::size_t begin = (std::size_t{u8(0)} - 1) * kBlock;
    if (u8(0) < 2 || begin + 4 > bytes_.size()) {
      fail(0, fmt::format("{} as the block of the parameters", u8(0)),
           fmt::format("a block from 2 to {}", bytes_.size() / kBlock));
    }
    const std::uint8_t code = u8(begin + 3);
    if (code < 84 || code > 86) {
      fail(begin + 3, fmt::format("processor {}", code), "84 (Intel), 85 (DEC) or 86 (SGI)");
    }
    file_.processor = static_cast<C3dProcessor>(code);
    return begin;
  }

  void read_parameter_section(std::size_t begin) {
    // The section's own count of blocks is often wrong; it reaches at most to the data.
    const std::size_t data_block = u16(word(9));
    std::size_t end = data_block * kBlock - kBlock;
    if (data_block == 0 || end <= begin || end > bytes_.size()) end = bytes_.size();

    std::unordered_map<int, std::size_t> group_of_id;
    std::vector<std::pair<int, C3dParameter>> parameters;
    std::size_t at = begin + 4;
    while (at < end && u8(at) != 0) {
      const std::size_t record = at;
      const auto need = [&](std::size_t from, std::size_t count, std::string_view what) {
        if (count > end - std::min(from, end)) {
          fail(record, fmt::format("the parameter section's end at byte {}", end), what);
        }
      };
      const int length = static_cast<std::int8_t>(u8(at));
      const std::size_t letters = static_cast<std::size_t>(std::abs(length));
      need(at, letters + 4, "a whole name of a group or parameter");
      const int id = static_cast<std::int8_t>(u8(at + 1));
      if (id == 0) fail(at + 1, "group 0", "a group's number other than 0");
      std::string name(bytes_.substr(at + 2, letters));
      const std::size_t pointer = at + 2 + letters;
      const std::size_t offset = u16(pointer);
      at = pointer + 2;
      C3dParameter parameter{.name = std::move(name), .locked = length < 0};
      if (id > 0) {
        need(at, 2, "a parameter's type and number of dimensions");
        const int type = static_cast<std::int8_t>(u8(at));
        const std::size_t dimensions = u8(at + 1);
        if (type != -1 && type != 1 && type != 2 && type != 4) {
          fail(at, fmt::format("type {} of parameter {}", type, shown(parameter.name)),
               "-1 (text), 1 (bytes), 2 (integers) or 4 (reals)");
        }
        if (dimensions > kMaxDimensions) {
          fail(at + 1,
               fmt::format("{} dimensions of parameter {}", dimensions, shown(parameter.name)),
               "at most 7");
        }
        at += 2;
        need(at, dimensions, "a parameter's dimensions");
        std::size_t count = 1;
        for (std::size_t i = 0; i < dimensions; ++i) {
          parameter.dimensions.push_back(u8(at + i));
          // Seven dimensions of 255 stay far below the range of size_t.
          count *= u8(at + i);
        }
        at += dimensions;
        const std::size_t width = static_cast<std::size_t>(std::abs(type));
        need(at, count * width,
             fmt::format("{} values of parameter {}", count, shown(parameter.name)));
        parameter.values = read_values(type, at, count);
        at += count * width;
      }
      // A pointer may jump over slack, but not back into the record nor out of the section; one
      // that does the latter is of no use, and the record's own end is taken.
      std::size_t next = pointer + offset;
      if (offset != 0 && next < at) {
        fail(pointer, fmt::format("{} bytes to the next record", offset),
             fmt::format("at least {}", at - pointer));
      }
      const bool points_on = offset != 0 && next <= end;
      const std::size_t limit = points_on ? next : end;
      if (at < limit) {
        const std::size_t described = std::min<std::size_t>(u8(at), limit - at - 1);
        parameter.description = std::string(bytes_.substr(at + 1, described));
        at += 1 + described;
      }
      if (id < 0) {
        if (group_of_id.emplace(-id, file_.groups.size()).second) {
          file_.groups.push_back(
              {std::move(parameter.name), std::move(parameter.description), parameter.locked, {}});
        }
      } else {
        parameters.emplace_back(id, std::move(parameter));
      }
      if (offset == 0) break;
      if (points_on) at = next;
    }
    for (auto& [id, parameter] : parameters) {
      // A parameter of no group has no name by which anybody could ask for it.
      if (const auto group = group_of_id.find(id); group != group_of_id.end()) {
        file_.groups[group->second].parameters.push_back(std::move(parameter));
      }
    }
    if (file_.groups.empty()) fail(begin + 4, "no parameters", "at least the group POINT");
  }

  C3dParameter::Values read_values(int type, std::size_t at, std::size_t count) const {
    switch (type) {
      case -1:
        return std::string(bytes_.substr(at, count));
      case 1: {
        std::vector<std::int8_t> values(count);
        for (std::size_t i = 0; i < count; ++i) values[i] = static_cast<std::int8_t>(u8(at + i));
        return values;
      }
      case 2: {
        std::vector<std::int16_t> values(count);
        for (std::size_t i = 0; i < count; ++i) values[i] = i16(at + 2 * i);
        return values;
      }
      default: {
        std::vector<float> values(count);
        for (std::size_t i = 0; i < count; ++i) values[i] = f32(at + 4 * i);
        return values;
      }
    }
  }

  static std::string shown(std::string_view name) {
    std::string result(name.substr(0, 40));
    std::replace_if(
        result.begin(), result.end(), [](unsigned char c) { return c < 32 || c > 126; }, '?');
    return fmt::format("\"{}\"", result);
  }

  // The numbers of a parameter and of those that continue it. Integers of the format's second
  // byte are signed or not as whoever wrote them pleased.
  std::vector<double> numbers(std::string_view group, std::string_view name,
                              bool is_unsigned) const {
    std::vector<double> all;
    for (std::size_t part = 1;; ++part) {
      const C3dParameter* p = file_.find(group, c3d::continued(name, part));
      if (p == nullptr) return all;
      const bool wraps =
          is_unsigned && std::holds_alternative<std::vector<std::int16_t>>(p->values);
      for (const double value : p->numbers()) {
        all.push_back(wraps && value < 0.0 ? value + 65536.0 : value);
      }
    }
  }
  std::optional<double> number(std::string_view group, std::string_view name,
                               bool is_unsigned = false) const {
    const std::vector<double> all = numbers(group, name, is_unsigned);
    return all.empty() ? std::nullopt : std::optional(all.front());
  }
  // A count: an unsigned word or a whole real number.
  std::optional<std::size_t> count(std::string_view group, std::string_view name) const {
    const std::optional<double> value = number(group, name, true);
    if (!value) return std::nullopt;
    if (!(*value >= 0.0 && *value <= 4294967295.0) || *value != std::floor(*value)) {
      fail(fmt::format("{}:{}", group, name), fmt::format("{}", *value), "a count");
    }
    return static_cast<std::size_t>(*value);
  }
  std::vector<std::string> strings(std::string_view group, std::string_view name) const {
    std::vector<std::string> all;
    for (std::size_t part = 1;; ++part) {
      const C3dParameter* p = file_.find(group, c3d::continued(name, part));
      if (p == nullptr) return all;
      const std::vector<std::string> some = p->strings();
      all.insert(all.end(), some.begin(), some.end());
    }
  }
  std::string string(std::string_view group, std::string_view name) const {
    const std::vector<std::string> all = strings(group, name);
    return all.empty() ? std::string() : all.front();
  }

  // TRIAL's field numbers are 32 bits in two words, the lower first.
  std::optional<std::size_t> field(std::string_view name) const {
    const std::vector<double> words = numbers("TRIAL", name, true);
    if (words.empty()) return std::nullopt;
    const double value = words[0] + (words.size() > 1 ? 65536.0 * words[1] : 0.0);
    if (!(value >= 0.0 && value <= 4294967295.0)) return std::nullopt;
    return static_cast<std::size_t>(value);
  }

  std::size_t parameter_frames(std::size_t header_frames) const {
    const std::optional<std::size_t> frames = count("POINT", "FRAMES");
    if (const auto many = count("POINT", "LONG_FRAMES"); many && *many > 0) return *many;
    const std::optional<std::size_t> first = field("ACTUAL_START_FIELD");
    const std::optional<std::size_t> last = field("ACTUAL_END_FIELD");
    const bool has_fields = first && last && *last >= *first;
    if (frames && *frames > 0 && *frames != c3d::kLargestWord) return *frames;
    if (has_fields) return *last - *first + 1;
    return frames && *frames > 0 ? *frames : header_frames;
  }

  void choose_layout() {
    const std::size_t first = u16(word(4)), last = u16(word(5));
    file_.first_frame = field("ACTUAL_START_FIELD").value_or(first);

    Layout header;
    header.points = u16(word(2));
    header.samples = u16(word(10));
    header.channels = header.samples == 0 ? 0 : u16(word(3)) / header.samples;
    header.frames = last >= first ? last - first + 1 : 0;
    header.scale = f32(word(7));

    Layout told = header;
    told.points = count("POINT", "USED").value_or(header.points);
    told.scale = number("POINT", "SCALE").value_or(header.scale);
    told.frames = parameter_frames(header.frames);
    told.channels = count("ANALOG", "USED").value_or(header.channels);
    const double ratio =
        number("ANALOG", "RATE").value_or(0.0) / number("POINT", "RATE").value_or(0.0);
    if (ratio >= 0.5 && ratio <= 65535.0 && std::abs(ratio - std::round(ratio)) < 0.01 * ratio) {
      told.samples = static_cast<std::size_t>(std::round(ratio));
    }
    if (told.channels > 0 && told.samples == 0) told.samples = 1;
    if (told.channels == 0) told.samples = 0;
    if (header.channels == 0) header.samples = 0;

    const auto scaled = [](const Layout& l) { return std::isfinite(l.scale) && l.scale != 0.0; };
    if (!scaled(told)) told.scale = header.scale;
    if (!scaled(told)) fail("POINT:SCALE", fmt::format("{}", told.scale), "a number other than 0");
    if (!scaled(header)) header.scale = told.scale;

    if (told.frame_bytes() == 0) {
      fail("POINT:USED and ANALOG:USED", "0 points and 0 channels", "at least one of either");
    }
    if (told.frames == 0) fail("POINT:FRAMES", "0", "at least one frame");

    // What header and parameters say should agree. Where it does not, the data section's own
    // length decides: it ends within the file's last block.
    std::vector<std::size_t> starts;
    for (const std::size_t block :
         {std::size_t{u16(word(9))}, count("POINT", "DATA_START").value_or(0)}) {
      const std::size_t start = (block - 1) * kBlock;
      if (block > u8(0) && start < bytes_.size()) starts.push_back(start);
    }
    if (starts.empty()) {
      fail(word(9), fmt::format("{} as the block of the data", u16(word(9))),
           fmt::format("a block from {} to {}", u8(0) + 1, bytes_.size() / kBlock));
    }
    const auto fits = [&](const Layout& l, std::size_t start) {
      return l.frame_bytes() > 0 && l.frames > 0 &&
             l.frames <= (bytes_.size() - start) / l.frame_bytes();
    };
    const auto fits_exactly = [&](const Layout& l, std::size_t start) {
      return fits(l, start) && bytes_.size() - start - l.frames * l.frame_bytes() < kBlock;
    };
    for (const Layout& layout : {told, header}) {
      for (const std::size_t start : starts) {
        if (fits_exactly(layout, start)) return use(layout, start);
      }
    }
    if (!told.same_frame(header)) {
      fail(word(2), header.text(), fmt::format("what the parameters say, {}", told.text()));
    }
    if (!fits(told, starts.front())) {
      fail(bytes_.size(),
           fmt::format("the end of the file after {} frames",
                       (bytes_.size() - starts.front()) / told.frame_bytes()),
           told.text());
    }
    use(told, starts.front());
  }

  void use(const Layout& layout, std::size_t start) {
    layout_ = layout;
    data_ = start;
    file_.storage = layout.real() ? C3dStorage::kReal : C3dStorage::kInteger;
  }

  void read_rate_and_unit() {
    const auto usable = [](double rate) { return rate >= 1e-3 && rate <= 1e6; };
    double rate = number("POINT", "RATE").value_or(0.0);
    if (!usable(rate)) rate = f32(word(11));
    if (!usable(rate)) fail("POINT:RATE", fmt::format("{}", rate), "0.001 to 1000000 Hz");
    file_.markers.rate_hz = rate;
    const std::string unit = string("POINT", "UNITS");
    metres_ = c3d::metres_per_unit(unit);
    if (metres_ == 0.0) fail("POINT:UNITS", shown(unit), "mm, cm, m, in or ft");
  }

  static std::string_view without_prefix(std::string_view name) noexcept {
    return name.substr(name.rfind(':') + 1);
  }

  void name_points() {
    const std::vector<std::string> labels = strings("POINT", "LABELS");
    const std::vector<std::string> descriptions = strings("POINT", "DESCRIPTIONS");
    std::unordered_map<std::string_view, const c3d::KindParameters*> kind_of;
    std::array<std::vector<std::string>, c3d::kKinds.size()> lists;
    std::array<std::string, c3d::kKinds.size()> units;
    for (std::size_t k = 0; k < c3d::kKinds.size(); ++k) {
      lists[k] = strings("POINT", c3d::kKinds[k].list);
      units[k] = string("POINT", c3d::kKinds[k].units);
      if (units[k].empty()) units[k] = c3d::kKinds[k].default_unit;
      for (const std::string& name : lists[k]) {
        if (name.empty()) continue;
        kind_of.emplace(name, &c3d::kKinds[k]);
        kind_of.emplace(without_prefix(name), &c3d::kKinds[k]);
      }
    }
    std::unordered_set<std::string> used;
    // Where each label's numbering goes on, so that a thousand equal labels take no million steps.
    std::unordered_map<std::string, std::size_t> repeated;
    marker_or_derived_.reserve(layout_.points);
    for (std::size_t i = 0; i < layout_.points; ++i) {
      const std::string label =
          i < labels.size() && !labels[i].empty() ? labels[i] : fmt::format("*{}", i + 1);
      std::string name = label;
      while (!used.insert(name).second) {
        std::size_t& k = repeated.try_emplace(label, 1).first->second;
        name = fmt::format("{}_{}", label, ++k);
      }
      std::string description = i < descriptions.size() ? descriptions[i] : std::string();
      auto kind = kind_of.find(label);
      if (kind == kind_of.end()) kind = kind_of.find(without_prefix(label));
      if (kind == kind_of.end()) {
        marker_or_derived_.push_back({true, file_.markers.names.size()});
        file_.markers.names.push_back(std::move(name));
        file_.marker_descriptions.push_back(std::move(description));
      } else {
        marker_or_derived_.push_back({false, file_.derived.size()});
        const auto k = static_cast<std::size_t>(kind->second - c3d::kKinds.data());
        C3dDerived derived{.name = std::move(name),
                           .description = std::move(description),
                           .kind = kind->second->kind,
                           .unit = units[k]};
        derived.values.reserve(layout_.frames);
        derived.valid.reserve(layout_.frames);
        file_.derived.push_back(std::move(derived));
      }
    }
    std::vector<std::string>& all = file_.marker_descriptions;
    if (std::all_of(all.begin(), all.end(), [](const auto& d) { return d.empty(); })) all.clear();
  }

  void name_channels() {
    is_unsigned_ = c3d::equals_ignoring_case(string("ANALOG", "FORMAT"), "UNSIGNED");
    const double general = number("ANALOG", "GEN_SCALE").value_or(1.0);
    const std::vector<double> scales = numbers("ANALOG", "SCALE", false);
    const std::vector<double> offsets = numbers("ANALOG", "OFFSET", is_unsigned_);
    const std::vector<std::string> labels = strings("ANALOG", "LABELS");
    const std::vector<std::string> units = strings("ANALOG", "UNITS");
    const std::vector<std::string> descriptions = strings("ANALOG", "DESCRIPTIONS");
    const auto text = [](const std::vector<std::string>& all, std::size_t i) {
      return i < all.size() ? all[i] : std::string();
    };
    for (std::size_t i = 0; i < layout_.channels; ++i) {
      C3dAnalog channel{
          .name = text(labels, i), .description = text(descriptions, i), .unit = text(units, i)};
      if (channel.name.empty()) channel.name = fmt::format("*{}", i + 1);
      channel.scale = (i < scales.size() ? scales[i] : 1.0) * general;
      channel.offset = i < offsets.size() ? offsets[i] : 0.0;
      if (!std::isfinite(channel.scale) || !std::isfinite(channel.offset)) {
        fail("ANALOG:SCALE, GEN_SCALE or OFFSET",
             fmt::format("scale {} and offset {} of channel {}", channel.scale, channel.offset,
                         shown(channel.name)),
             "finite numbers");
      }
      channel.values.reserve(layout_.frames * layout_.samples);
      file_.analog.push_back(std::move(channel));
    }
  }

  struct Point {
    Eigen::Vector3d p;
    bool valid;
    float residual;  // in the file's unit
  };
  Point read_point(std::size_t at) const noexcept {
    Point point{};
    double fourth = 0.0;
    if (layout_.real()) {
      point.p = {f32(at), f32(at + 4), f32(at + 8)};
      fourth = f32(at + 12);
    } else {
      point.p = layout_.scale * Eigen::Vector3d(i16(at), i16(at + 2), i16(at + 4));
      fourth = i16(at + 6);
    }
    // The fourth word is an integer even where it is stored as a real: cameras in the upper byte,
    // residual in the lower. The comparison also refuses NaN.
    point.valid = fourth >= 0.0 && point.p.allFinite();
    if (point.valid && fourth < 32768.0) {
      point.residual =
          static_cast<float>((static_cast<unsigned>(fourth) & 0xFFU) * std::abs(layout_.scale));
    }
    return point;
  }

  void read_data() {
    const std::size_t point_bytes = layout_.real() ? 16 : 8;
    const std::size_t sample_bytes = layout_.real() ? 4 : 2;
    const std::size_t markers = file_.markers.names.size();
    file_.markers.frames.reserve(layout_.frames);
    std::size_t at = data_;
    for (std::size_t f = 0; f < layout_.frames; ++f) {
      MarkerFrame& frame = file_.markers.frames.emplace_back(markers);
      for (const auto& [is_marker, i] : marker_or_derived_) {
        const Point point = read_point(at);
        if (point.valid && point.p.cwiseAbs().maxCoeff() > c3d::kLargestValue) {
          fail(
              at,
              fmt::format("{:g} of point {} in frame {}", point.p.cwiseAbs().maxCoeff(),
                          shown(is_marker ? file_.markers.names[i] : file_.derived[i].name), f + 1),
              "at most 1e9");
        }
        at += point_bytes;
        if (!is_marker) {
          file_.derived[i].values.push_back(point.valid ? point.p : Eigen::Vector3d::Zero());
          file_.derived[i].valid.push_back(point.valid ? 1 : 0);
        } else if (point.valid && !point.p.isZero(0.0)) {
          frame.p_WM[i] = metres_ * point.p;
          frame.visible[i] = 1;
          frame.residual[i] = static_cast<float>(metres_ * point.residual);
        }
      }
      for (std::size_t s = 0; s < layout_.samples; ++s) {
        for (C3dAnalog& channel : file_.analog) {
          const double stored = layout_.real() ? static_cast<double>(f32(at))
                                : is_unsigned_ ? static_cast<double>(u16(at))
                                               : static_cast<double>(i16(at));
          at += sample_bytes;
          channel.values.push_back((stored - channel.offset) * channel.scale);
        }
      }
    }
  }

  void read_events() {
    const std::vector<std::string> labels = strings("EVENT", "LABELS");
    const std::vector<std::string> contexts = strings("EVENT", "CONTEXTS");
    const std::vector<double> times = numbers("EVENT", "TIMES", false);  // minutes, seconds
    const std::size_t used = count("EVENT", "USED").value_or(0);
    for (std::size_t i = 0; i < used && 2 * i + 1 < times.size(); ++i) {
      add_event(i < labels.size() ? labels[i] : std::string(),
                i < contexts.size() ? contexts[i] : std::string(),
                60.0 * times[2 * i] + times[2 * i + 1]);
    }
    if (used > 0) return;
    // Older files have up to 18 events of four letters in the header.
    constexpr std::uint16_t kFourLetters = 12345;
    constexpr std::size_t kMost = 18;
    if (u16(word(150)) != kFourLetters) return;
    const std::size_t events = std::min<std::size_t>(u16(word(151)), kMost);
    for (std::size_t i = 0; i < events; ++i) {
      std::string label(bytes_.substr(word(199) + 4 * i, 4));
      label.resize(std::min(label.find('\0'), label.size()));
      while (label.ends_with(' ')) label.pop_back();
      add_event(std::move(label), {}, f32(word(153) + 4 * i));
    }
  }
  void add_event(std::string label, std::string context, double time) {
    if (!std::isfinite(time)) return;
    file_.events.push_back({std::move(label), std::move(context), time});
  }

  struct Place {
    bool is_marker;
    std::size_t index;
  };

  std::string_view bytes_;
  std::string_view name_;
  C3dFile file_;
  Layout layout_;
  std::size_t data_ = 0;  // where the first frame begins
  double metres_ = 0.001;
  bool is_unsigned_ = false;
  std::vector<Place> marker_or_derived_;  // one per point of the file
};

}  // namespace

C3dFile read_c3d(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::error_code ignored;
  if (!in || std::filesystem::is_directory(file, ignored)) {
    throw C3dError(
        fmt::format("{}: byte 0: found no readable file, expected a C3D file", file.string()));
  }
  return read_c3d(in, file.string());
}

C3dFile read_c3d(std::istream& in, std::string_view name) {
  std::string bytes;
  std::array<char, 1 << 16> block;
  while (in.read(block.data(), block.size()) || in.gcount() > 0) {
    bytes.append(block.data(), static_cast<std::size_t>(in.gcount()));
  }
  return Reader(bytes, name).read();
}

}  // namespace secondskin
