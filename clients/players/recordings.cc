#include "clients/players/recordings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <fstream>

#include "bus/topics.h"
#include "clients/players/topic_file.h"
#include "recording/mcap_format.h"
#include "recording/mcap_reader.h"

namespace secondskin::players {
namespace {

namespace fs = std::filesystem;
namespace msg = bus::msg;
using State = RecordingInfo::State;

constexpr auto kSilence = std::chrono::seconds(5);  // a recorder writes at least each half second

std::int64_t unix_ns(fs::file_time_type time) {
  const auto at = std::chrono::file_clock::to_sys(time).time_since_epoch();
  return std::chrono::duration_cast<std::chrono::nanoseconds>(at).count();
}

/// Without its end a recording has to be read whole; what has no beginning is none.
bool is_quick(const fs::path& file) {
  using recording::mcap::kMagic;
  std::ifstream in(file, std::ios::binary);
  const auto is_magic = [&] {
    std::array<char, kMagic.size()> bytes{};
    return in.read(bytes.data(), bytes.size()) &&
           std::memcmp(bytes.data(), kMagic.data(), bytes.size()) == 0;
  };
  if (!is_magic()) return true;
  return in.seekg(-static_cast<std::streamoff>(kMagic.size()), std::ios::end) && is_magic();
}

void read(const fs::path& file, RecordingInfo& info) {
  recording::McapReader reader(file);
  info.subject = subject_of(reader);
  info.start_ns = reader.start_ns();
  info.end_ns = reader.end_ns();
  info.state = reader.finished() ? State::kFinished : State::kUnfinished;
  for (const auto& [id, topic] : topics_of(reader)) {
    const auto& channels = reader.channels();
    const auto channel = std::find_if(channels.begin(), channels.end(),
                                      [id = id](const auto& c) { return c.id == id; });
    if (topic == bus::kTopicOf<msg::RepetitionScore>) info.repetitions = channel->messages;
    if (topic == bus::kTopicOf<msg::Alignment>) info.coached = channel->messages > 0;
  }
  const auto settings = reader.metadata().find("settings");
  if (settings == reader.metadata().end()) return;
  const auto reference = settings->second.find("reference");
  if (reference != settings->second.end()) info.references.push_back(reference->second);
}

}  // namespace

std::optional<fs::path> Recordings::find(const std::string& name) const {
  const fs::path asked(name);
  if (name.empty() || name.starts_with('.') || asked.filename() != asked ||
      asked.extension() != ".mcap" ||
      name.find_first_of(std::string_view("/\\\0", 3)) != name.npos) {
    return std::nullopt;
  }
  std::error_code error;
  const fs::path file = fs::canonical(folder_ / asked, error);
  if (error || file.parent_path() != fs::canonical(folder_, error) || error ||
      !fs::is_regular_file(file, error)) {
    return std::nullopt;
  }
  return file;
}

RecordingInfo Recordings::describe(const fs::path& file) { return look(file, false); }
RecordingInfo Recordings::scan(const fs::path& file) { return look(file, true); }

RecordingInfo Recordings::look(const fs::path& file, bool whole) {
  const std::string name = file.filename().string();
  std::error_code error;
  const std::uint64_t bytes = fs::file_size(file, error);
  const auto written = fs::last_write_time(file, error);
  RecordingInfo info;
  bool same = false;
  {
    const std::lock_guard lock(mutex_);
    if (const auto known = known_.find(name); known != known_.end()) {
      info = known->second.info;
      same = known->second.bytes == bytes && known->second.written == written;
    }
  }
  if (!same && (whole || is_quick(file))) {
    info = {};
    try {
      read(file, info);
    } catch (const std::exception& why) {
      info.state = State::kDamaged;
      info.error = without_folder(why.what());
    }
    const std::lock_guard lock(mutex_);
    known_[name] = {bytes, written, info};
    same = true;
  }
  info.name = name;
  info.bytes = bytes;
  if (!same) {
    info.state = State::kUnfinished;
    info.error.clear();
  }
  const bool fresh = fs::file_time_type::clock::now() - written < kSilence;
  if (info.state == State::kUnfinished && fresh) {
    info.state = State::kBeingRecorded;
    // What is recorded was recorded until it was written: a growing file is read once only.
    if (info.start_ns > 0) info.end_ns = std::max(info.end_ns, unix_ns(written));
    info.read = info.start_ns > 0;
  } else {
    info.read = same;
  }
  return info;
}

std::vector<RecordingInfo> Recordings::list() {
  std::vector<RecordingInfo> all;
  std::error_code error;
  for (fs::directory_iterator it(folder_, error), end; !error && it != end; it.increment(error)) {
    if (const auto file = find(it->path().filename().string())) all.push_back(describe(*file));
  }
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) {
    return a.start_ns != b.start_ns ? a.start_ns > b.start_ns : a.name < b.name;
  });
  return all;
}

std::string Recordings::digest(std::string_view text) {
  std::uint64_t hash = 14695981039346656037ull;  // FNV-1a, 64 bit
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return fmt::format("{:016x}", hash);
}

std::string Recordings::without_folder(std::string words) const {
  std::error_code error;
  for (const fs::path& folder : {fs::canonical(folder_, error), fs::absolute(folder_, error)}) {
    if (folder.empty()) continue;
    const std::string path = (folder / "").string();
    for (auto at = words.find(path); at != words.npos; at = words.find(path)) {
      words.erase(at, path.size());
    }
  }
  return words;
}

std::string Recordings::key_of(const fs::path& file, std::string_view kind, std::string_view more) {
  std::error_code error;
  return fmt::format(
      "{}-{}", kind,
      digest(fmt::format("{}|{}|{}|{}", file.string(), fs::file_size(file, error),
                         fs::last_write_time(file, error).time_since_epoch().count(), more)));
}

Learners Recordings::learners(const fs::path& file, std::stop_token stop) const {
  try {
    const auto kept = learners_in(states() / (key_of(file, "states") + ".mcap"), stop);
    if (!kept.ids.empty()) return kept;
  } catch (const recording::McapError&) {
    // There are none, or they are torn.
  }
  return learners_in(file, stop);
}

Forgotten Recordings::forget(const std::string& learner, const Progress& progress,
                             std::stop_token stop) {
  Forgotten out;
  std::error_code error;
  const auto all = list();
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (progress) progress(static_cast<double>(i) / static_cast<double>(all.size()));
    const std::string& name = all[i].name;
    const auto file = find(name);
    if (!file) continue;  // gone meanwhile
    const auto keep = [&](const std::string& why) { out.kept.push_back({name, why}); };
    Learners theirs;
    try {
      theirs = learners(*file, stop);
    } catch (const std::exception& why) {
      if (stop.stop_requested()) throw;
      keep("cannot be read, so it may be theirs: " + without_folder(why.what()));
      continue;
    }
    if (!theirs.ids.contains(learner)) {
      if (theirs.ids.empty() && !theirs.sure) {
        keep("parts of it cannot be read, and the rest names nobody, so it may be theirs");
      }
    } else if (all[i].state == State::kBeingRecorded) {
      keep("is being recorded");
    } else if (theirs.ids.size() > 1) {
      keep("has sessions of other learners, too");
    } else if (fs::remove(*file, error)) {
      out.removed.push_back(name);
    } else {
      keep(error.message());
    }
  }
  // Unfinished ones, too: of a program that was killed.
  for (fs::recursive_directory_iterator it(computed(), error), end; !error && it != end;
       it.increment(error)) {
    std::error_code ignored;
    const auto kind = it->path().extension();
    if (kind == ".mcap" || kind == ".part") fs::remove(it->path(), ignored);
  }
  return out;
}

}  // namespace secondskin::players
