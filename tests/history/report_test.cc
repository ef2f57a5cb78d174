#include "clients/history/report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "clients/history/pdf.h"
#include "course.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

/// Twelve sessions over five weeks, getting better.
std::vector<Session> weeks() {
  std::vector<Session> all;
  for (int i = 0; i < 12; ++i) {
    const std::int64_t start = kMorning + i * 3 * kDay;
    const double base = 85.0 - 45.0 * std::exp(-i / 4.0);
    all.push_back(session_of(
        i + 1, start,
        {block_of(0, "off", start, {base - 6, base - 4, base - 5}),
         block_of(1, "always", start + 100 * kSecond, {base, base + 3, base + 6, base + 2}),
         block_of(2, "off", start + 500 * kSecond, {base + 1, base - 2, base})}));
    for (Block& block : all.back().blocks) {
      for (Repetition& repetition : block.repetitions) {
        repetition.joints.clear();
        for (const char* joint : {"left_knee", "right_knee", "left_hip", "right_hip", "chest"}) {
          repetition.joints.push_back(
              {joint, true, (1.0 - base / 100.0) * 0.4, 0.5, 0.7, {}, {}, 1.0, 1.1});
        }
      }
    }
  }
  return all;
}

const Learner kLearner{.id = "L-TEST34",
                       .note = "left knee",
                       .created_ns = kMorning,
                       .sessions = 12,
                       .last_session_ns = {}};

TEST(Report, EscapesAllText) {
  auto course = weeks();
  const std::string evil = "<script>alert('&\"')</script>";
  for (Session& session : course) {
    session.plan = session.reference.name = session.reference.description = evil;
    session.exposure[0].segment = evil;
    for (Block& block : session.blocks) {
      block.name = evil;
      for (auto& repetition : block.repetitions) repetition.joints[0].joint = evil;
    }
  }
  course[3].blocks[0].schedule = evil;
  Learner learner = kLearner;
  learner.id = learner.note = evil;
  const std::string html = report_html(learner, course, kMorning + 40 * kDay);
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_NE(html.find("&lt;script&gt;alert(&#39;&amp;&quot;&#39;)&lt;/script&gt;"),
            std::string::npos);
}

TEST(Report, NeedsNothingFromElsewhere) {
  const std::string html = report_html(kLearner, weeks(), kMorning + 40 * kDay);
  for (const char* reaches_out : {" src=", "href", "@import", "url("}) {
    EXPECT_EQ(html.find(reaches_out), std::string::npos) << reaches_out;
  }
  EXPECT_EQ(html.find("://"), html.find("://www.w3.org/2000/svg")) << "a name, not an address";
  EXPECT_NE(html.find("default-src 'none'"), std::string::npos);
}

TEST(Report, SaysTheFiguresAndWhatTheyRestOn) {
  const std::string html = report_html(kLearner, weeks(), kMorning + 40 * kDay);
  EXPECT_NE(html.find("12 sessions, 120 repetitions, 12.0 hours"), std::string::npos);
  EXPECT_NE(html.find("Deep squat, down and up. The expert takes 2.2 s."), std::string::npos);
  EXPECT_NE(html.find("100 % of the expert’s tempo, tolerances × 1"), std::string::npos);
  EXPECT_NE(html.find("in the session"), std::string::npos);
  EXPECT_NE(html.find("across days"), std::string::npos);
  EXPECT_NE(html.find("What the numbers mean"), std::string::npos);
}

TEST(Report, OfNobodySaysSo) {
  const std::string html = report_html(kLearner, {}, kMorning);
  EXPECT_NE(html.find("No repetition has been finished yet."), std::string::npos);
}

TEST(Pdf, HoldsTheReport) {
  const session::Folder folder;
  std::string pdf;
  try {
    pdf = pdf_of(report_html(kLearner, weeks(), kMorning + 40 * kDay));
  } catch (const std::exception& error) {
    if (std::string(error.what()).find("is not there") != std::string::npos) {
      GTEST_SKIP() << error.what();
    }
    throw;
  }
  std::ofstream(folder / "report.pdf", std::ios::binary) << pdf;
  const std::string file = folder / "report.pdf", text = folder / "report.txt";
  if (std::system("command -v pdftotext >/dev/null") != 0) GTEST_SKIP() << "pdftotext is not there";
  ASSERT_EQ(std::system(("pdftotext -layout " + file + " " + text).c_str()), 0);
  const std::string words = session::read_text(text);
  EXPECT_NE(words.find("Training report"), std::string::npos);
  EXPECT_NE(words.find("12 sessions, 120 repetitions"), std::string::npos);
  EXPECT_NE(words.find("1/"), std::string::npos) << "pages are numbered";
}

TEST(Pdf, WithoutTheProgramSaysWhatToInstall) {
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", "/nowhere", 1);
  std::string words;
  try {
    pdf_of("<p>nothing</p>");
  } catch (const std::exception& error) {
    words = error.what();
  }
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_NE(words.find("weasyprint"), std::string::npos) << words;
  EXPECT_NE(words.find("install"), std::string::npos) << words;
}

}  // namespace
}  // namespace secondskin::history
