//! A page as a person has it: headless Chromium, steered over a pipe in the DevTools protocol
//! (<https://chromedevtools.github.io/devtools-protocol/>). The main type is [`Browser`], which opens a [`Page`] with a
//! [`Look`].

use std::{
    fs,
    io::{BufRead, BufReader, Write as _},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Chromium ends by itself after these, so that one that hangs fails its test.
const TIMEOUT_S: &str = "300";
/// The pipe is on descriptors 3 and 4; what it says besides is not ours.
const START: &str = "exec timeout \"$1\" chromium --headless --no-sandbox --disable-dev-shm-usage --remote-debugging-pipe \
    --hide-scrollbars --disable-background-networking --user-data-dir=\"$2\" \
    3<&0 4>&1 </dev/null >/dev/null 2>&1";

/// How a page is looked at.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// Its width in CSS pixels.
    pub width: u32,
    /// Its height in CSS pixels.
    pub height: u32,
    /// Whether it is a telephone's.
    pub phone: bool,
    /// Whether the person prefers dark pages.
    pub dark: bool,
    /// Whether the page's scripts run.
    pub scripts: bool,
}

impl Look {
    /// A telephone, upright.
    pub const PHONE: Self = Self {
        width: 390,
        height: 844,
        phone: true,
        dark: false,
        scripts: true,
    };
    /// A tablet, upright.
    pub const TABLET: Self = Self {
        width: 820,
        height: 1180,
        ..Self::PHONE
    };
    /// A window on a desk.
    pub const DESKTOP: Self = Self {
        width: 1280,
        height: 800,
        phone: false,
        ..Self::PHONE
    };

    /// The same in the dark.
    #[must_use]
    pub const fn dark(self) -> Self {
        Self { dark: true, ..self }
    }

    /// The same without JavaScript.
    #[must_use]
    pub const fn without_scripts(self) -> Self {
        Self {
            scripts: false,
            ..self
        }
    }
}

/// A browser of one's own, with a new profile. It is closed when this is dropped.
pub struct Browser {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    last: u64,
    events: Vec<Value>,
    _profile: TempDir,
}

impl Browser {
    /// Starts Chromium.
    #[must_use]
    pub fn start() -> Self {
        let profile = TempDir::with_prefix("matrix-browser-").expect("a folder for the profile");
        let mut child = Command::new("sh")
            .args(["-c", START, "sh", TIMEOUT_S])
            .arg(profile.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("sh starts");
        let mut browser = Self {
            to: child.stdin.take().expect("a pipe to it"),
            from: BufReader::new(child.stdout.take().expect("a pipe from it")),
            child,
            last: 0,
            events: Vec::new(),
            _profile: profile,
        };
        browser.ask(None, "Browser.getVersion", json!({}));
        browser
    }

    /// Opens a page and waits until it is loaded.
    pub fn open(&mut self, file: &Path, look: Look) -> Page<'_> {
        let target = self.ask(None, "Target.createTarget", json!({"url": "about:blank"}));
        let attached = self.ask(
            None,
            "Target.attachToTarget",
            json!({"targetId": target["targetId"], "flatten": true}),
        );
        let session = attached["sessionId"].as_str().expect("a session").to_owned();
        let url = format!("file://{}", file.display());
        let mut page = Page {
            browser: self,
            session,
            url: url.clone(),
        };
        for domain in ["Page", "Runtime", "Log", "Network"] {
            page.ask(&format!("{domain}.enable"), json!({}));
        }
        let scale = if look.phone { 2 } else { 1 };
        page.ask(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": look.width, "height": look.height, "deviceScaleFactor": scale, "mobile": look.phone}),
        );
        let colours = if look.dark { "dark" } else { "light" };
        page.ask(
            "Emulation.setEmulatedMedia",
            json!({"features": [{"name": "prefers-color-scheme", "value": colours}]}),
        );
        page.ask(
            "Emulation.setScriptExecutionDisabled",
            json!({"value": !look.scripts}),
        );
        page.ask("Page.navigate", json!({"url": url}));
        page.wait_for("Page.loadEventFired");
        page
    }

    /// The answer to a request, of the browser itself or of one page.
    fn ask(&mut self, session: Option<&str>, method: &str, parameters: Value) -> Value {
        self.last += 1;
        let mut request = json!({"id": self.last, "method": method, "params": parameters});
        if let Some(session) = session {
            request["sessionId"] = session.into();
        }
        self.to
            .write_all(format!("{request}\0").as_bytes())
            .and_then(|()| self.to.flush())
            .expect("Chromium listens");
        loop {
            let mut answer = self.next();
            if answer["id"] == self.last {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].take();
            }
            self.events.push(answer);
        }
    }

    fn next(&mut self) -> Value {
        let mut bytes = Vec::new();
        self.from.read_until(0, &mut bytes).expect("the pipe can be read");
        assert_eq!(
            bytes.pop(),
            Some(0),
            "Chromium ended: is it installed (tests/prepare), or was it given more than {TIMEOUT_S} s of work?"
        );
        serde_json::from_slice(&bytes).expect("Chromium says JSON")
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.to.write_all(b"{\"id\": 0, \"method\": \"Browser.close\"}\0");
        let _ = self.child.wait();
    }
}

/// An open page.
pub struct Page<'a> {
    browser: &'a mut Browser,
    session: String,
    url: String,
}

impl Page<'_> {
    fn ask(&mut self, method: &str, parameters: Value) -> Value {
        self.browser.ask(Some(&self.session), method, parameters)
    }

    fn wait_for(&mut self, event: &str) {
        let is_it = |said: &Value, session: &str| said["method"] == event && said["sessionId"] == session;
        if self.browser.events.iter().any(|said| is_it(said, &self.session)) {
            return;
        }
        loop {
            let said = self.browser.next();
            let found = is_it(&said, &self.session);
            self.browser.events.push(said);
            if found {
                return;
            }
        }
    }

    /// What an expression of JavaScript comes to, whether or not the page's own scripts run.
    pub fn value(&mut self, expression: &str) -> Value {
        let mut answer = self.ask(
            "Runtime.evaluate",
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true}),
        );
        let failed = &answer["exceptionDetails"];
        assert!(failed.is_null(), "{expression}: {failed}");
        answer["result"]["value"].take()
    }

    /// Presses the left button of the mouse in the midst of an element, which is scrolled to.
    pub fn click(&mut self, selector: &str) {
        let at = self.value(&format!(
            "(() => {{ const element = document.querySelector({selector:?}); \
             element.scrollIntoView({{block: 'center', inline: 'center'}}); \
             const box = element.getBoundingClientRect(); \
             return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            self.ask(
                "Input.dispatchMouseEvent",
                json!({"type": kind, "x": at[0], "y": at[1], "button": "left", "clickCount": 1}),
            );
        }
    }

    /// Presses a key: `Tab`, or `Enter`.
    pub fn press(&mut self, key: &str) {
        let (code, text) = match key {
            "Tab" => (9, ""),
            "Enter" => (13, "\r"),
            other => panic!("{other} is not known here"),
        };
        for kind in ["keyDown", "keyUp"] {
            self.ask(
                "Input.dispatchKeyEvent",
                json!({"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code, "text": text}),
            );
        }
    }

    /// What the page said on the console, what failed, and what it asked for besides itself.
    pub fn complaints(&mut self) -> Vec<String> {
        // Whatever was said before the answer to this is here then.
        self.value("0");
        let said = self.browser.events.iter();
        said.filter(|said| said["sessionId"] == self.session.as_str())
            .filter(|said| match said["method"].as_str().unwrap_or_default() {
                "Runtime.consoleAPICalled" | "Runtime.exceptionThrown" | "Log.entryAdded" => true,
                "Network.requestWillBeSent" => said["params"]["request"]["url"] != self.url.as_str(),
                _ => false,
            })
            .map(Value::to_string)
            .collect()
    }

    /// By how many pixels the page is wider than the screen.
    pub fn overflow(&mut self) -> i64 {
        self.value("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            .as_i64()
            .expect("a number of pixels")
    }

    /// What axe-core holds against the page by the rules of WCAG 2.2, levels A and AA: one line for each element.
    ///
    /// # Panics
    /// When axe-core is not there, or found nothing to look at.
    pub fn barriers(&mut self) -> Vec<String> {
        let axe = fs::read_to_string(axe()).expect("tests/prepare has put axe-core there");
        self.value(&format!("{axe}\n0"));
        let found = self.value(
            "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}).then(found => ({ \
             passed: found.passes.length, \
             barriers: found.violations.flatMap(rule => rule.nodes.map(node => \
             `${rule.id}: ${node.target} ${node.failureSummary} ${node.html.slice(0, 200)}`)) }))",
        );
        assert!(
            found["passed"].as_u64() > Some(0),
            "axe-core looked at something: {found}"
        );
        let barriers = found["barriers"].as_array().expect("a list");
        barriers.iter().map(ToString::to_string).collect()
    }

    /// The whole page as PNG.
    pub fn screenshot(&mut self, file: &Path) {
        let picture = self.ask(
            "Page.captureScreenshot",
            json!({"format": "png", "captureBeyondViewport": true}),
        );
        write(file, &picture);
    }

    /// The page as it is printed on A4, as PDF.
    pub fn print(&mut self, file: &Path) {
        let printed = self.ask(
            "Page.printToPDF",
            json!({"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": true}),
        );
        write(file, &printed);
    }

    /// From now on as on paper of this width, in CSS pixels.
    pub fn on_paper(&mut self, width: u32) {
        self.ask("Emulation.setEmulatedMedia", json!({"media": "print"}));
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": false}),
        );
    }
}

fn write(file: &Path, answer: &Value) {
    let data = answer["data"].as_str().expect("Chromium answers with data");
    let bytes = STANDARD.decode(data).expect("the data is Base64");
    fs::write(file, bytes).unwrap_or_else(|error| panic!("{} can be written: {error}", file.display()));
}

/// Where tests/prepare puts axe-core.
fn axe() -> PathBuf {
    let home = std::env::var_os("HOME").expect("a home");
    Path::new(&home).join(".cache/matrix-python/axe.min.js")
}
