//! Calls and responses as XML, read and written. The main functions are [`read_call`] and [`read_response`].
//!
//! A peer decides what is read here: nesting is bounded, since it is read by recursion, and document type
//! declarations are refused, since entities of one's own are an old way to exhaust a reader.

use std::{borrow::Cow, collections::BTreeMap, fmt::Write};

use quick_xml::{Reader, escape::resolve_predefined_entity, events::Event};

use super::{server::Fault, value::Value};

/// Values in values: parameters of real robots stay below ten.
const DEEPEST: usize = 32;

/// Why a text is not XML-RPC.
#[derive(Debug, thiserror::Error)]
pub(in crate::ros) enum DocumentError {
    #[error("it is not XML: {0}")]
    Xml(#[from] quick_xml::Error),
    #[error("it has {found} where {wanted} belongs")]
    Unexpected { found: String, wanted: &'static str },
    #[error("`{text}` is not {wanted}")]
    Literal { text: String, wanted: &'static str },
    #[error("its values are nested deeper than {DEEPEST}")]
    TooDeep,
    #[error("it declares a document type")]
    DocumentType,
}

/// A method call.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::ros) struct Call {
    pub method: String,
    pub params: Vec<Value>,
}

/// Reads a `methodCall`.
pub(in crate::ros) fn read_call(xml: &str) -> Result<Call, DocumentError> {
    let mut parser = Parser::new(xml);
    parser.start("methodCall")?;
    parser.start("methodName")?;
    let method = parser.text()?.trim().to_owned();
    let params = match parser.tag()? {
        Token::Start(name) if name == "params" => parser.params()?,
        Token::End => Vec::new(),
        other => return Err(other.unexpected("<params>")),
    };
    Ok(Call { method, params })
}

/// Reads a `methodResponse`: its one value or its fault.
pub(in crate::ros) fn read_response(xml: &str) -> Result<Result<Value, Fault>, DocumentError> {
    let mut parser = Parser::new(xml);
    parser.start("methodResponse")?;
    match parser.tag()? {
        Token::Start(name) if name == "params" => {
            let value = parser.params()?.into_iter().next();
            Ok(Ok(value.unwrap_or(Value::Nil)))
        }
        Token::Start(name) if name == "fault" => {
            parser.start("value")?;
            Ok(Err(Fault::from_value(&parser.value(0)?)))
        }
        other => Err(other.unexpected("<params> or <fault>")),
    }
}

/// Writes a `methodCall`.
pub(in crate::ros) fn write_call(method: &str, params: &[Value]) -> String {
    let mut xml = String::from("<?xml version=\"1.0\"?>\n<methodCall><methodName>");
    write_text(&mut xml, method);
    xml.push_str("</methodName><params>");
    for param in params {
        write_param(&mut xml, param);
    }
    xml.push_str("</params></methodCall>\n");
    xml
}

/// Writes a `methodResponse`.
pub(in crate::ros) fn write_response(answer: &Result<Value, Fault>) -> String {
    let mut xml = String::from("<?xml version=\"1.0\"?>\n<methodResponse>");
    match answer {
        Ok(value) => {
            xml.push_str("<params>");
            write_param(&mut xml, value);
            xml.push_str("</params>");
        }
        Err(fault) => {
            xml.push_str("<fault>");
            write_value(&mut xml, &fault.to_value());
            xml.push_str("</fault>");
        }
    }
    xml.push_str("</methodResponse>\n");
    xml
}

fn write_param(xml: &mut String, value: &Value) {
    xml.push_str("<param>");
    write_value(xml, value);
    xml.push_str("</param>");
}

fn write_value(xml: &mut String, value: &Value) {
    xml.push_str("<value>");
    match value {
        // Writing to a string cannot fail.
        Value::Int(number) => drop(write!(xml, "<int>{number}</int>")),
        Value::Bool(truth) => drop(write!(xml, "<boolean>{}</boolean>", u8::from(*truth))),
        Value::Double(number) => drop(write!(xml, "<double>{number}</double>")),
        Value::Text(text) => write_element(xml, "string", text),
        Value::DateTime(text) => write_element(xml, "dateTime.iso8601", text),
        Value::Base64(text) => write_element(xml, "base64", text),
        Value::Nil => xml.push_str("<nil/>"),
        Value::Array(values) => {
            xml.push_str("<array><data>");
            for value in values {
                write_value(xml, value);
            }
            xml.push_str("</data></array>");
        }
        Value::Struct(members) => {
            xml.push_str("<struct>");
            for (name, value) in members {
                xml.push_str("<member>");
                write_element(xml, "name", name);
                write_value(xml, value);
                xml.push_str("</member>");
            }
            xml.push_str("</struct>");
        }
    }
    xml.push_str("</value>");
}

fn write_element(xml: &mut String, name: &str, text: &str) {
    let _ = write!(xml, "<{name}>");
    write_text(xml, text);
    let _ = write!(xml, "</{name}>");
}

fn write_text(xml: &mut String, text: &str) {
    for character in text.chars() {
        match character {
            '<' => xml.push_str("&lt;"),
            '>' => xml.push_str("&gt;"),
            '&' => xml.push_str("&amp;"),
            // A reader turns a bare one into a line feed.
            '\r' => xml.push_str("&#13;"),
            '\t' | '\n' => xml.push(character),
            // Not to be had in XML 1.0, not even as a reference.
            '\0'..'\x20' | '\u{fffe}' | '\u{ffff}' => xml.push('\u{fffd}'),
            _ => xml.push(character),
        }
    }
}

/// What the grammar of XML-RPC is made of.
enum Token {
    Start(String),
    Text(String),
    End,
    Eof,
}

impl Token {
    fn unexpected(self, wanted: &'static str) -> DocumentError {
        let found = match self {
            Self::Start(name) => format!("<{}>", name.chars().take(40).collect::<String>()),
            Self::Text(text) => format!("`{}`", text.chars().take(40).collect::<String>()),
            Self::End => "the end of an element".to_owned(),
            Self::Eof => "its end".to_owned(),
        };
        DocumentError::Unexpected { found, wanted }
    }
}

struct Parser<'a> {
    reader: Reader<&'a [u8]>,
}

impl<'a> Parser<'a> {
    fn new(xml: &'a str) -> Self {
        let mut reader = Reader::from_str(xml);
        reader.config_mut().expand_empty_elements = true;
        Self { reader }
    }

    fn token(&mut self) -> Result<Token, DocumentError> {
        loop {
            let text: Cow<'_, str> = match self.reader.read_event()? {
                Event::Start(tag) => {
                    return Ok(Token::Start(
                        String::from_utf8_lossy(tag.name().as_ref()).into_owned(),
                    ));
                }
                Event::End(_) => return Ok(Token::End),
                Event::Eof => return Ok(Token::Eof),
                Event::DocType(_) => return Err(DocumentError::DocumentType),
                Event::Decl(_) | Event::PI(_) | Event::Comment(_) | Event::Empty(_) => continue,
                Event::Text(text) => text.xml10_content().map_err(quick_xml::Error::from)?,
                Event::CData(text) => text.xml10_content().map_err(quick_xml::Error::from)?,
                Event::GeneralRef(reference) => {
                    if let Some(character) = reference.resolve_char_ref()? {
                        return Ok(Token::Text(character.to_string()));
                    }
                    let name = reference.decode().map_err(quick_xml::Error::from)?;
                    let text = resolve_predefined_entity(&name);
                    text.map(Cow::Borrowed).ok_or_else(|| DocumentError::Literal {
                        text: name.chars().take(40).collect(),
                        wanted: "a known entity",
                    })?
                }
            };
            return Ok(Token::Text(text.into_owned()));
        }
    }

    /// The next tag; only white space may stand before it.
    fn tag(&mut self) -> Result<Token, DocumentError> {
        loop {
            match self.token()? {
                Token::Text(text) if text.trim().is_empty() => {}
                Token::Text(text) => return Err(Token::Text(text).unexpected("a tag")),
                tag => return Ok(tag),
            }
        }
    }

    fn start(&mut self, wanted: &'static str) -> Result<(), DocumentError> {
        match self.tag()? {
            Token::Start(name) if name == wanted => Ok(()),
            other => Err(other.unexpected(wanted)),
        }
    }

    fn end(&mut self) -> Result<(), DocumentError> {
        match self.tag()? {
            Token::End => Ok(()),
            other => Err(other.unexpected("the end of an element")),
        }
    }

    /// The text up to the end of the element, white space included.
    fn text(&mut self) -> Result<String, DocumentError> {
        let mut whole = String::new();
        loop {
            match self.token()? {
                Token::Text(text) => whole.push_str(&text),
                Token::End => return Ok(whole),
                other => return Err(other.unexpected("text")),
            }
        }
    }

    /// What follows `<params>`, its end included.
    fn params(&mut self) -> Result<Vec<Value>, DocumentError> {
        let mut params = Vec::new();
        loop {
            match self.tag()? {
                Token::Start(name) if name == "param" => {
                    self.start("value")?;
                    params.push(self.value(0)?);
                    self.end()?;
                }
                Token::End => return Ok(params),
                other => return Err(other.unexpected("<param>")),
            }
        }
    }

    /// What follows `<value>`, its end included. Without a type it is a string.
    fn value(&mut self, depth: usize) -> Result<Value, DocumentError> {
        if depth > DEEPEST {
            return Err(DocumentError::TooDeep);
        }
        let mut untyped = String::new();
        loop {
            match self.token()? {
                Token::Text(text) => untyped.push_str(&text),
                Token::End => return Ok(Value::Text(untyped)),
                Token::Start(kind) if untyped.trim().is_empty() => {
                    let value = self.typed(&kind, depth)?;
                    self.end()?;
                    return Ok(value);
                }
                other => return Err(other.unexpected("</value>")),
            }
        }
    }

    fn typed(&mut self, kind: &str, depth: usize) -> Result<Value, DocumentError> {
        match kind {
            "array" => return self.array(depth),
            "struct" => return self.structure(depth),
            _ => {}
        }
        let text = self.text()?;
        let trimmed = text.trim();
        let literal = |wanted| DocumentError::Literal {
            text: trimmed.chars().take(40).collect(),
            wanted,
        };
        match kind {
            "int" | "i4" | "i8" => trimmed
                .parse()
                .map(Value::Int)
                .map_err(|_| literal("an integer of 32 bits")),
            "double" => trimmed
                .parse()
                .map(Value::Double)
                .map_err(|_| literal("a double")),
            "boolean" => match trimmed {
                "1" | "true" => Ok(Value::Bool(true)),
                "0" | "false" => Ok(Value::Bool(false)),
                _ => Err(literal("a boolean")),
            },
            "string" => Ok(Value::Text(text)),
            "dateTime.iso8601" => Ok(Value::DateTime(text)),
            "base64" => Ok(Value::Base64(text)),
            "nil" => Ok(Value::Nil),
            _ => Err(Token::Start(kind.to_owned()).unexpected("a type of XML-RPC")),
        }
    }

    fn array(&mut self, depth: usize) -> Result<Value, DocumentError> {
        self.start("data")?;
        let mut values = Vec::new();
        loop {
            match self.tag()? {
                Token::Start(name) if name == "value" => values.push(self.value(depth + 1)?),
                Token::End => break,
                other => return Err(other.unexpected("<value>")),
            }
        }
        self.end()?;
        Ok(Value::Array(values))
    }

    fn structure(&mut self, depth: usize) -> Result<Value, DocumentError> {
        let mut members = BTreeMap::new();
        loop {
            match self.tag()? {
                Token::Start(name) if name == "member" => {
                    self.start("name")?;
                    let name = self.text()?;
                    self.start("value")?;
                    members.insert(name, self.value(depth + 1)?);
                    self.end()?;
                }
                Token::End => return Ok(Value::Struct(members)),
                other => return Err(other.unexpected("<member>")),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_call_of_rospy_is_read() {
        let xml = "<?xml version='1.0'?>\n<methodCall>\n<methodName>registerPublisher</methodName>\n<params>\n\
            <param>\n<value><string>/talker</string></value>\n</param>\n\
            <param>\n<value><array><data>\n<value><int>3</int></value>\n<value><boolean>1</boolean></value>\n\
            </data></array></value>\n</param>\n</params>\n</methodCall>\n";
        let call = read_call(xml).unwrap();
        assert_eq!(call.method, "registerPublisher");
        assert_eq!(
            call.params,
            [Value::from("/talker"), Value::Array(vec![3.into(), true.into()])]
        );
    }

    #[rstest::rstest]
    #[case("<methodCall><methodName>getPid</methodName></methodCall>", 0)]
    #[case("<methodCall><methodName>getPid</methodName><params/></methodCall>", 0)]
    #[case(
        "<methodCall><methodName>getPid</methodName><params><param><value/></param></params></methodCall>",
        1
    )]
    fn params_may_be_absent_or_empty(#[case] xml: &str, #[case] count: usize) {
        assert_eq!(read_call(xml).unwrap().params, vec![Value::from(""); count]);
    }

    #[test]
    fn a_value_without_a_type_is_a_string_with_its_spaces() {
        let xml = "<methodResponse><params><param><value> a &amp;&#x20;<![CDATA[<b>]]> </value></param></params></methodResponse>";
        assert_eq!(read_response(xml).unwrap(), Ok(Value::from(" a & <b> ")));
    }

    #[test]
    fn a_fault_is_read_back_as_it_was_written() {
        let fault = Fault {
            code: -7,
            text: "no <such> method".into(),
        };
        assert_eq!(
            read_response(&write_response(&Err(fault.clone()))).unwrap(),
            Err(fault)
        );
    }

    #[test]
    fn nesting_without_end_is_refused_and_does_not_exhaust_the_stack() {
        let xml = format!(
            "<methodResponse><params><param>{}",
            "<value><array><data>".repeat(50_000)
        );
        assert!(matches!(read_response(&xml), Err(DocumentError::TooDeep)));
    }

    #[test]
    fn entities_of_ones_own_are_refused() {
        let xml =
            "<!DOCTYPE lolz [<!ENTITY lol \"lol\">]><methodCall><methodName>&lol;</methodName></methodCall>";
        assert!(matches!(read_call(xml), Err(DocumentError::DocumentType)));
        let xml = "<methodCall><methodName>&lol;</methodName></methodCall>";
        assert!(matches!(read_call(xml), Err(DocumentError::Literal { .. })));
    }

    #[rstest::rstest]
    #[case::empty("")]
    #[case::text("hello")]
    #[case::html("<html></html>")]
    #[case::cut("<methodCall><methodName>getPid")]
    #[case::crossed("<methodCall><methodName>getPid</methodCall></methodName>")]
    #[case::number(
        "<methodCall><methodName>x</methodName><params><param><value><int>1e9</int></value></param></params></methodCall>"
    )]
    fn what_is_not_a_call_is_refused(#[case] xml: &str) {
        assert!(read_call(xml).is_err());
    }

    fn values() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            any::<i32>().prop_map(Value::Int),
            any::<bool>().prop_map(Value::Bool),
            (-1e300..1e300).prop_map(Value::Double),
            "[ -~\t\n\rä→]{0,12}".prop_map(Value::Text),
            Just(Value::Nil),
        ];
        leaf.prop_recursive(3, 24, 4, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::Array),
                proptest::collection::btree_map("[a-z <&]{1,6}", inner, 0..4).prop_map(Value::Struct),
            ]
        })
    }

    proptest! {
        #[test]
        fn every_value_is_read_back_as_it_was_written(value in values()) {
            prop_assert_eq!(read_response(&write_response(&Ok(value.clone()))).unwrap(), Ok(value.clone()));
            let call = read_call(&write_call("m", &[value.clone(), 1.into()])).unwrap();
            prop_assert_eq!(call.params, [value, 1.into()]);
        }

        #[test]
        fn a_call_that_was_tampered_with_does_not_make_the_reader_panic(
            value in values(),
            changes in proptest::collection::vec((any::<proptest::sample::Index>(), "[<>/&;a0 ]?"), 1..4),
        ) {
            let mut xml: Vec<char> = write_call("m", &[value]).chars().collect();
            for (place, text) in changes {
                let place = place.index(xml.len());
                xml.splice(place..=place, text.chars());
            }
            let _ = read_call(&xml.into_iter().collect::<String>());
        }

        #[test]
        fn no_text_makes_the_reader_panic(
            xml in "(<(/)?(methodCall|methodName|params|param|value|int|array|data|struct|member|name)(/)?>|[a&;<>!#0-9 -]){0,40}"
        ) {
            let _ = read_call(&xml);
            let _ = read_response(&xml);
        }
    }
}
